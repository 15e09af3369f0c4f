"""Walks beyond a straight open-loop one: turns on the spot, velocities that change, lines that are held."""
