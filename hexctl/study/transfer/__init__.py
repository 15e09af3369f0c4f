"""Searches on robots that differ from the simulation."""
