"""Gaits: the factorial encoding of the paper, its foot trajectory, and the feet of a whole robot."""
