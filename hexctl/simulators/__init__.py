"""Simulated boards and buses of servos, which move a simulated robot."""
