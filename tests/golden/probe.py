"""Whether this machine and these versions compute the same bits as those on which the data was written.

Nothing of hexctl takes part, so that a change of hexctl cannot be mistaken for another machine.
"""

import hashlib
from functools import cache

import dm_control
import mujoco
import numpy as np

_TUMBLING = """
<mujoco>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body pos="0 0 1">
      <freejoint/>
      <geom type="box" size=".2 .1 .05"/>
      <body pos=".2 0 0">
        <joint type="hinge" axis="0 1 0" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@cache
def probe() -> dict[str, str]:
    """Versions, how Python adds, and a fingerprint of a simulation and of some linear algebra."""
    model = mujoco.MjModel.from_xml_string(_TUMBLING)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=500)
    random = np.random.default_rng(0)
    matrix = random.standard_normal((120, 120))
    solved = np.linalg.solve(matrix @ matrix.T + np.eye(120), random.standard_normal(120))
    curved = np.sin(matrix) + np.exp(matrix)
    bits = b"".join(np.ascontiguousarray(part).tobytes() for part in (data.qpos, solved, curved))
    return {
        "mujoco": mujoco.__version__,
        "dm_control": getattr(dm_control, "__version__", ""),
        "numpy": np.__version__,
        "sum": repr(sum([0.1] * 10)),  # more exact from Python 3.12 on
        "bits": hashlib.sha256(bits).hexdigest()[:16],
    }
