"""Learned walks: the hexapod as a Gymnasium environment, and policies trained in it."""
