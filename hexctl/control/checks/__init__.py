"""Checks of a robot: loads, ranges, clearance, and the default gait that passes them."""
