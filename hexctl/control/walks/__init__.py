"""Walks: turns on the spot, changing velocities, held lines."""
