"""Priors from simulations of many plausible worlds, and beliefs after trials."""
