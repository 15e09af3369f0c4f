"""How fast hexctl is, as ratios against a bare reference in the same run wherever there is one.

`python -m benchmarks` runs them all; docs of each number are in the docstring of its module.
"""

import os

# dm_control looks for a display when it is imported; no benchmark draws anything.
os.environ.setdefault("MUJOCO_GL", "disable")

# As the command does, and for the same reason; before anything imports NumPy.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
