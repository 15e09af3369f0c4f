"""One control tick without physics: read, gait, inverse kinematics, guard, write, log, as `drive` times it.

As hexctl runs an open-loop walk, which plans many ticks at once; planning every tick by itself; a walk that
is steered, which answers to the state at every tick; and one that also watches its legs. What watches them is
measured alone as well.
"""

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from statistics import median
from unittest.mock import patch

import numpy as np

import hexctl.control.controllers
from benchmarks.plans import ant, default_gait
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.mock import MockServos
from hexctl.backends.sim.servos import SimClock
from hexctl.control.controllers import LOOK_AHEAD_TICKS, Controller, Walk
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.loop import run_controller
from hexctl.control.monitor.leg_monitor import LegMonitor
from hexctl.control.monitor.monitored_walk import recovering_walk
from hexctl.control.preparation import WalkStart
from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.gait.gait import Motion
from hexctl.types import N_JOINTS, N_LEGS, FloatArray, RobotState


def tick_rows(scale: Scale) -> Iterator[Row]:
    """Time of one control tick, median and p99.9: planned ahead, tick by tick, steered, and monitored."""
    kinds: dict[str, tuple[str, Callable[[], FloatArray], bool]] = {
        name: (f"planned {at_once} at once", partial(_work_us, scale.ticks, at_once), True)
        for name, at_once in (("ahead", LOOK_AHEAD_TICKS), ("alone", 1))
    }
    kinds["steered"] = ("holding a line", partial(_steered_us, scale.ticks, SteeredWalk), True)
    watching = partial(_steered_us, scale.ticks, recovering_walk())
    kinds["monitored"] = ("holding a line, watching its legs", watching, False)
    for name, (how, measure, barred) in kinds.items():
        rounds = [measure() for _ in range(scale.rounds)]
        note = f"median of {scale.rounds} rounds of {scale.ticks} ticks, {how}"
        for what, percent, limit_us in (("median", 50, 100), ("p99_9", 99.9, 1000)):
            value_us = median(float(np.percentile(work_us, percent)) for work_us in rounds)
            bar = Bar(high=limit_us) if barred else None
            yield Row(f"tick.{name}.{what}", value_us, "us", bar, note)
    value_us = median(_monitor_us(scale.ticks) for _ in range(scale.rounds))
    note = f"median of {scale.rounds} rounds of {scale.ticks} ticks, the leg monitor alone"
    yield Row("tick.monitor", value_us, "us", Bar(high=30), note)


#: Ticks that are timed as one: what the monitor does differs from tick to tick.
BLOCK_TICKS = 20


def _monitor_us(ticks: int) -> float:
    """Median over blocks of the time that the leg monitor of one robot takes for a tick, in µs."""
    robot, gait, period_s = ant(), default_gait(), 0.02
    noise = 0.01 * np.random.default_rng(0).standard_normal((BLOCK_TICKS, N_JOINTS))
    targets_rad = robot.stance_angles_rad + noise
    states = [
        RobotState(measured_rad, 0.0, True, None, None, joint_torques_nm=np.full(N_JOINTS, 0.5))
        for measured_rad in targets_rad + noise[::-1]
    ]
    monitor = LegMonitor(robot, (), period_s, np.array(gait.pace_hz))
    cycles = gait.pace_hz * period_s * np.arange(ticks)
    phases = (cycles[:, np.newaxis] + np.arange(N_LEGS) / N_LEGS) % 1
    blocks_us = []
    for first in range(0, ticks, BLOCK_TICKS):
        begun_s = time.perf_counter()
        for k in range(BLOCK_TICKS):
            monitor.update(states[k], phases[(first + k) % ticks])
            monitor.sent(targets_rad[k])
        blocks_us.append((time.perf_counter() - begun_s) / BLOCK_TICKS * 1e6)
    return median(blocks_us)


def _steered_us(ticks: int, make: Callable[[WalkStart], Controller]) -> FloatArray:
    """The work of each tick of a walk that holds its line, in µs, on a robot that stands where it is."""
    log, plan = TickLog(), TrialPlan(gait=default_gait(), hold="line")
    frame = TrialFrame(np.zeros(3), 0.0, 0.0)
    with PosedMock() as servos:
        start = WalkStart(robot=ant(), plans=(plan,), period_s=servos.clock.period_s, frame=frame)
        run_controller(Guard(servos), make(start), (log,), until=lambda step, _: step >= ticks - 1)
    return np.asarray(log["work_s"] * 1e6)


#: Poses that a posed mock goes through again and again.
POSES = 1000


class PosedMock(MockServos):
    """A mock robot that measures joints, torques and its pose: it sways and turns about its line."""

    def __init__(self) -> None:
        super().__init__(ant(), clock=SimClock(lambda: None))
        sway = np.sin(math.tau * np.arange(POSES) / POSES)
        self._positions_world = np.stack([0 * sway, 0.02 * sway, 0.1 + 0 * sway], axis=-1)
        half_rad = math.radians(1.0) * sway
        self._quaternions_world = np.stack([np.cos(half_rad), 0 * sway, 0 * sway, np.sin(half_rad)], axis=-1)
        self._torques_nm = np.full(N_JOINTS, 0.5)
        self._reads = 0

    def read(self) -> RobotState:
        """State with a pose and torques."""
        row, self._reads = self._reads % POSES, self._reads + 1
        return RobotState(
            self._positions_rad.copy(),
            stamp_s=self._clock.now_s,
            measured=True,
            base_position_world=self._positions_world[row],
            base_quaternion_world=self._quaternions_world[row],
            joint_torques_nm=self._torques_nm.copy(),
        )


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
