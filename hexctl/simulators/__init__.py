"""Simulated servo boards and buses, which move a simulated robot."""
