"""Golden data: what hexctl did at a known commit, and the code that measures the same of today's."""

import os

# Read when NumPy is imported; sums of more threads have other last bits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
