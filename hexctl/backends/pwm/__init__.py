"""Hobby servos behind a board that makes their pulses: no servo says where it is."""
