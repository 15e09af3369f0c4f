"""Tracks of a recording over time, one module for each kind."""
