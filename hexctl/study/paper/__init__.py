"""Experiments of the paper: searches over all gaits of each failed leg, claims and their report."""
