"""Gaits: the factorial encoding of the paper, gaits and motions, and the foot trajectory."""
