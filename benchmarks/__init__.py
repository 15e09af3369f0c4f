"""How fast hexctl is, as ratios against a bare reference in the same run wherever there is one.

`python -m benchmarks` runs them all; docs of each number are in the docstring of its module.
"""

import os

# dm_control looks for a display when it is imported; no benchmark draws anything.
os.environ.setdefault("MUJOCO_GL", "disable")
