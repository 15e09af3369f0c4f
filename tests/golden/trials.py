"""A handful of simulated trials that between them use every robot, failure and kind of world."""

import hashlib
import math
import platform
import re
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import dm_control
import mujoco
import numpy as np

from hexctl import (
    Failure,
    Guard,
    SimServos,
    SimTrial,
    World,
    load_robot,
    load_world,
    run_sim_trials,
    run_trial,
)
from hexctl.control.log import TickLog
from hexctl.types import FloatArray
from tests.trials import sim_trial

NOISY = World.model_validate({"sensor_noise": {"joint_deg": 0.5, "position_m": 0.002, "yaw_deg": 0.5}})
WORN = World(servo_delay_s=0.02, servo_backlash_deg=1.0, servo_strength=0.7, joint_offset_deg=2.0)
LOADED = World(payload_kg=0.4, payload_position_m=(0.03, 0.0, 0.02), friction_cone="pyramidal")
TOP_HEAVY = World(payload_kg=3.0, payload_position_m=(0.0, 0.0, 0.6))
TIPPING = World(payload_kg=6.0, payload_position_m=(0.5, 0.0, 0.3))

#: Columns of logs that are also kept as numbers.
SAMPLED = ("commanded_rad", "measured_rad", "base_position_world")


def _trial(gait: str, robot: str = "ant", facing_rad: float = 0.0, **given: Any) -> SimTrial:
    made = sim_trial(gait, robot=load_robot(robot), **{"duration_s": 3.0, "world": World(), **given})
    return replace(made, facing_rad=facing_rad)


def trials() -> dict[str, SimTrial]:
    """The trials by name."""
    stuck = Failure(leg=1, kind="stuck", joint="femur", angle_rad=math.radians(20))
    weak = Failure(leg=4, kind="weak", torque_fraction=0.2)
    return {
        "demo": _trial("demo"),
        "tripod, heading": _trial("tripod", heading_rad=2.0),
        "wave, curve": _trial("wave", turn_rate_rad_s=0.1, travel=0.5),
        "turned on the spot": _trial("ripple", travel=0.0, turn_rate_rad_s=0.2),
        "locked": _trial("57", failure=Failure(leg=3)),
        "locked, noisy": _trial("57", world=NOISY, seed=5, failure=Failure(leg=3)),
        "locked, noisy, another": _trial("120", world=NOISY, seed=5, failure=Failure(leg=3)),
        "limp, front, rough": _trial(
            "11",
            world=load_world("rough"),
            seed=2,
            failure=Failure(leg=2, kind="limp"),
            self_rotation="front",
        ),
        "missing, not turned, worn": _trial(
            "90", world=WORN, seed=7, failure=Failure(leg=6, kind="missing"), self_rotation="none"
        ),
        "stuck, loaded": _trial("33", world=LOADED, failure=stuck),
        "slippery": _trial("tripod", world=load_world("slippery")),
        "uphill": _trial("1", world=load_world("slope"), failure=Failure(leg=5)),
        "put down turned": _trial("demo", facing_rad=1.0, heading_rad=-1.0),
        "turned by an angle": _trial("57", failure=Failure(leg=3), turn_rad=0.6),
        "phantomx": _trial("10", robot="phantomx", failure=Failure(leg=2)),
        "pexod, weak": _trial("wave", robot="pexod", failure=weak),
        "falls": _trial("wave", world=TOP_HEAVY, duration_s=6.0),
        "falls before it walks": _trial("demo", world=TIPPING),
        "half a minute": _trial("90", failure=Failure(leg=5), duration_s=30.0),
    }


@dataclass(frozen=True)
class Walked:
    """A trial on a simulated robot of its own.

    Attributes:
        result: to the last bit.
        log: digests of every tick, the soft stop too.
        samples: each tick of the walk's first second and every half second, and the whole path, by column;
            single precision resolves 3e-7.
    """

    result: dict[str, Any]
    log: dict[str, Any]
    samples: dict[str, FloatArray]


def alone(trial: SimTrial) -> Walked:
    """Run a trial."""
    log = TickLog()
    with SimServos(
        trial.robot,
        world=trial.world,
        failures=trial.failures,
        seed=trial.seed,
        facing_rad=trial.facing_rad,
    ) as servos:
        result = run_trial(Guard(servos), trial.plan, recorders=(log,))
    digests = {name: digest(log[name]) for name in ("time_s", *SAMPLED)}
    first = log.walk_from or 0
    rows = sorted({*range(0, len(log), 25), *range(first, min(first + 50, len(log)))})
    samples = {name: log[name][rows].astype(np.float32) for name in SAMPLED}
    samples["path"] = result.path_m.astype(np.float32)
    return Walked(exact(result), {"ticks": len(log), **digests}, samples)


def together(several: list[SimTrial]) -> list[tuple[dict[str, Any], FloatArray]]:
    """The results of trials in one batch, and their paths."""
    return [(exact(result), result.path_m) for result in run_sim_trials(several)]


def exact(result: Any) -> dict[str, Any]:
    """A trial's result to the last bit, as JSON: floats are written so that they come back the same."""
    deviation = result.deviation
    return {
        "status": result.status,
        "duration_s": result.duration_s,
        "turned_rad": result.turned_rad,
        "distance_m": result.distance_m,
        "ideal_distance_m": result.ideal_distance_m,
        "deviation_m": None
        if deviation is None
        else {field.name: getattr(deviation, field.name) for field in fields(deviation)},
        "yaw_change_rad": result.yaw_change_rad,
        "clipped_ticks": result.clipped_ticks,
        "path": digest(result.path_m),
    }


def digest(array: Any) -> str:
    """Shape and fingerprint of an array's bits."""
    values = np.ascontiguousarray(array, dtype=float)
    return f"{'x'.join(map(str, values.shape))}:{hashlib.sha256(values.tobytes()).hexdigest()[:16]}"


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
    """Versions, how Python adds, a fingerprint of a simulation and some linear algebra, and the processor.

    It says whether a machine computes the bits of that of the data. Nothing of hexctl takes part: a change of
    hexctl cannot be mistaken for another machine.
    """
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
        "processor": _processor(),
    }


def _processor() -> str:
    """Maker and kind of the processor, as Linux reports them."""
    keys = r"^(?:vendor_id|cpu family|model|CPU implementer|CPU part)\s*:\s*(.*)$"
    first, *_ = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")
    return " ".join([platform.machine(), *re.findall(keys, first, re.M)])
