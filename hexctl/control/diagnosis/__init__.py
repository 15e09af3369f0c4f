"""Diagnosis at rest: which leg and joint failed, and how, from motions of a standing robot."""
