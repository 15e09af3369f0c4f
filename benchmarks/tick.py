"""One control tick without physics: read, gait, inverse kinematics, guard, write, log, as `drive` times it.

Twice: as hexctl runs, which plans many ticks of a walk at once, and planning every tick by itself, which is
what a controller that answers to the state would pay.
"""

from collections.abc import Iterator
from statistics import median
from unittest.mock import patch

import numpy as np

import hexctl.control.controllers
from benchmarks.plans import ant, default_gait
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.mock import MockServos
from hexctl.backends.sim.servos import SimClock
from hexctl.control.controllers import LOOK_AHEAD_TICKS, Walk
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.loop import run_controller
from hexctl.gait.gait import Motion
from hexctl.types import FloatArray


def tick_rows(scale: Scale) -> Iterator[Row]:
    """Time of one control tick, median and p99.9, with the look-ahead and planned tick by tick."""
    for name, ticks_at_once in (("ahead", LOOK_AHEAD_TICKS), ("alone", 1)):
        rounds = [_work_us(scale.ticks, ticks_at_once) for _ in range(scale.rounds)]
        note = f"median of {scale.rounds} rounds of {scale.ticks} ticks, planned {ticks_at_once} at once"
        for what, percent, limit_us in (("median", 50, 100), ("p99_9", 99.9, 1000)):
            value_us = median(float(np.percentile(work_us, percent)) for work_us in rounds)
            yield Row(f"tick.{name}.{what}", value_us, "us", Bar(high=limit_us), note)


def _work_us(ticks: int, ticks_at_once: int) -> FloatArray:
    """Return the work of each tick of a walk in µs, on a mock robot whose clock does not wait."""
    clock = SimClock(lambda: None)
    log = TickLog()
    with (
        MockServos(ant(), clock=clock) as servos,
        patch.object(hexctl.control.controllers, "LOOK_AHEAD_TICKS", ticks_at_once),
    ):
        walk = Walk(ant(), default_gait(), Motion(), period_s=clock.period_s)
        run_controller(Guard(servos), walk, (log,), until=lambda step, _: step >= ticks - 1)
    return np.asarray(log["work_s"] * 1e6)
