"""Leg servos: the abstract interface, its clocks, and what implements it."""
