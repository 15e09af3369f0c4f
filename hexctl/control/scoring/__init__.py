"""Scores of walks, causes of bad ones, and the uncertainty of the simulation."""
