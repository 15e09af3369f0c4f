"""Simulated hardware: servo boards, buses, a camera, and legs that fail."""
