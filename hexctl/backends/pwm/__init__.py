"""Hobby servos behind a board that generates their pulses; they have no position feedback."""
