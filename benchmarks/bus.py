"""Servos on a bus: walks of minutes on a simulated bus of each family, at the speed of its line."""

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.base import LegServos, ServosWrapper
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.control.guard import Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.gait.gait import make_gait
from hexctl.robot.configs import find_config
from hexctl.robot.loader import load_robot_file
from hexctl.types import FloatArray, JointTargets, RobotState

#: Families: driver, model, and the largest age of a joint's angle in 99 of 100 periods, in s.
FAMILIES = {
    "x": ("dynamixel", "xl430-w250", 0.020),
    "sts": ("feetech", "sts3215", 0.020),
    "ax": ("dynamixel", "ax12a", 0.080),
    "lx": ("lx16a", "lx16a", 0.080),
}

#: Time that a tick spends in `read` and `write`, in 99 of 100.
IO_MS = 1.0

#: Share of answers that are garbled, and of those that are wild.
DAMAGED = 0.005


@dataclass(slots=True)
class BusTimes:
    """What was seen of a bus at each tick.

    Attributes:
        ages_s: of the joints' angles, (18,) each.
        io_s: spent in `read` and `write`.
        angles_rad: measured, (18,) each.
        writes: packets with targets so far.
    """

    ages_s: list[FloatArray] = field(default_factory=list)
    io_s: list[float] = field(default_factory=list)
    angles_rad: list[FloatArray] = field(default_factory=list)
    writes: list[int] = field(default_factory=list)

    @property
    def unsent(self) -> int:
        """Ticks of the walk whose targets were replaced before they were sent."""
        first = len(self.writes) // 10  # the torque is switched on at first
        return max(0, len(self.writes) - 1 - first - (self.writes[-1] - self.writes[first]))


class TimedServos(ServosWrapper):
    """Servos that note how old their joints are and what a tick spends on them."""

    def __init__(self, servos: LegServos) -> None:
        super().__init__(servos)
        self.times = BusTimes()
        self._read_s = 0.0

    def read(self) -> RobotState:
        """Read, and note the ages."""
        began_s = time.perf_counter()
        state = super().read()
        self._read_s = time.perf_counter() - began_s
        if state.servos is not None:
            self.times.ages_s.append(state.servos.ages_s)
            self.times.angles_rad.append(state.joint_positions_rad)
        return state

    def write(self, targets: JointTargets) -> JointTargets:
        """Write, and note the time."""
        began_s = time.perf_counter()
        sent = super().write(targets)
        self.times.io_s.append(self._read_s + time.perf_counter() - began_s)
        self.times.writes.append(self.link_counts["writes"])
        return sent


def bus_rows(scale: Scale) -> Iterator[Row]:
    """Ticks, ages and times of each family, and a bus that damages one answer in a hundred."""
    for name, (driver, model, age_s) in FAMILIES.items():
        result, servos = _walked(driver, model, scale.bus_s)
        note = _note(result, servos, scale.bus_s)
        yield Row(f"bus.{name}.skipped", servos.clock.overruns, "ticks", Bar(high=0), note)
        ages_ms = 1e3 * np.percentile(np.stack(servos.times.ages_s), 99)
        yield Row(f"bus.{name}.age_p99", float(ages_ms), "ms", Bar(high=1e3 * age_s), "of all joints")
        io_ms = 1e3 * float(np.percentile(servos.times.io_s, 99))
        yield Row(f"bus.{name}.io_p99", io_ms, "ms", Bar(high=IO_MS), "read and write of a tick")
        yield Row(
            f"bus.{name}.unsent",
            servos.times.unsent,
            "writes",
            Bar(high=0),
            "ticks whose targets were replaced",
        )
        faults = (f"garble:{DAMAGED}", f"wild:{DAMAGED}")
        result, servos = _walked(driver, model, scale.bus_s, *faults)
        note = _note(result, servos, scale.bus_s)
        stops = int(result.status == "aborted")
        yield Row(
            f"bus.{name}.damaged.stops",
            stops,
            "stops",
            Bar(high=0),
            f"{100 * 2 * DAMAGED:g} % damaged; {note}",
        )
        yield Row(f"bus.{name}.damaged.jumps", _jumps(servos), "jumps", Bar(high=0), _counts(servos))


def _jumps(servos: TimedServos) -> int:
    """Changes of angles between two ticks that no joint can make: 3 times its speed, and 2 deg."""
    steps = np.abs(np.diff(np.stack(servos.times.angles_rad), axis=0))
    new_s = np.maximum(PERIOD_S, np.stack(servos.times.ages_s)[:-1])
    most = 3 * servos.robot.joint_max_speed_rad_s * new_s + np.radians(2.0)
    return int(np.count_nonzero(steps > most))


def _note(result: TrialResult, servos: TimedServos, duration_s: float) -> str:
    ended = result.status if result.stopped is None else f"{result.status} ({result.stopped})"
    return f"{duration_s:g} s, {ended}, {len(servos.times.io_s)} ticks"


def _counts(servos: TimedServos) -> str:
    return ", ".join(f"{count} {name}" for name, count in servos.link_counts.items())


def _walked(driver: str, model: str, duration_s: float, *faults: str) -> tuple[TrialResult, TimedServos]:
    """Walk `phantomx` on a simulated bus, which is its own process; joints follow their targets."""
    with TemporaryDirectory() as folder, _board(Path(folder), driver, model, *faults) as (file, port):
        robot_file = load_robot_file(file)
        options = BackendOptions(robot=robot_file.robot, robot_file=robot_file, connect=port)
        servos = TimedServos(make_servos(driver, options))
        plan = TrialPlan(gait=make_gait(servos.robot, "tripod"), duration_s=duration_s, hold="none")
        with Guard(servos) as guard:
            result = run_trial(guard, plan)
        return result, servos


@contextmanager
def _board(folder: Path, driver: str, model: str, *faults: str) -> Iterator[tuple[Path, str]]:
    """A simulated bus: the robot file that fits it, and its port."""
    content = yaml.safe_load(find_config("robots", "phantomx").read_text(encoding="utf-8"))
    content["servos"] = {
        "driver": driver,
        "model": model,
        "femur": {"offset_deg": -10},
        "tibia": {"offset_deg": 40},
    }
    file = folder / "robot.yaml"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    command = [sys.executable, "-u", "-m", "hexctl", "sim", "board", "--bus", driver, "--backend", "mock"]
    told = [word for fault in faults for word in ("--fault", fault)]
    process = subprocess.Popen([*command, "--robot", str(file), *told], stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        said = process.stderr.readline()
        found = re.search(r" at (/\S+),", said)
        if found is None:
            raise RuntimeError(f"hexctl sim board did not come up: {said}")
        yield file, found[1]
    finally:
        process.terminate()
        process.wait(10)
