"""Servos on a bus: walks of minutes on a simulated bus of each family, at the speed of its line."""

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.base import LegServos, ServosWrapper
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.control.guard import Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.gait.gait import make_gait
from hexctl.robot.configs import find_config
from hexctl.robot.loader import load_robot_file
from hexctl.types import JOINT_NAMES, FloatArray, RobotState

#: Families: driver, model, and the largest age of a joint's angle in 99 of 100 periods, in s.
FAMILIES = {
    "x": ("dynamixel", "xl430-w250", 0.020),
    "sts": ("feetech", "sts3215", 0.020),
    "ax": ("dynamixel", "ax12a", 0.080),
    "lx": ("lx16a", "lx16a", 0.080),
}


class TimedServos(ServosWrapper):
    """Servos that note how old the angles of their joints are, (18,) each, in s."""

    def __init__(self, servos: LegServos) -> None:
        super().__init__(servos)
        self.ages_s: list[FloatArray] = []

    def read(self) -> RobotState:
        """Read, and note the ages."""
        state = super().read()
        if state.servos is not None:
            self.ages_s.append(state.servos.ages_s)
        return state


def bus_rows(scale: Scale) -> Iterator[Row]:
    """Ages of the angles of each family."""
    for name, (driver, model, age_s) in FAMILIES.items():
        result, ages_s = _walked(driver, model, scale.bus_s)
        ended = result.status if result.stopped is None else f"{result.status} ({result.stopped})"
        note = f"of all joints, {scale.bus_s:g} s, {ended}"
        ages_ms = 1e3 * float(np.percentile(np.stack(ages_s), 99))
        yield Row(f"bus.{name}.age_p99", ages_ms, "ms", Bar(high=1e3 * age_s), note)


def _walked(driver: str, model: str, duration_s: float) -> tuple[TrialResult, list[FloatArray]]:
    """Walk `phantomx` on a simulated bus, which is its own process; joints follow their targets."""
    with TemporaryDirectory() as folder, _board(Path(folder), driver, model) as (file, port):
        robot_file = load_robot_file(file)
        options = BackendOptions(robot=robot_file.robot, robot_file=robot_file, port=port)
        servos = TimedServos(make_servos(driver, options))
        plan = TrialPlan(gait=make_gait(servos.robot, "tripod"), duration_s=duration_s, hold="none")
        with Guard(servos) as guard:
            result = run_trial(guard, plan)
        return result, servos.ages_s


@contextmanager
def _board(folder: Path, driver: str, model: str) -> Iterator[tuple[Path, str]]:
    """A simulated bus: the robot file that fits it, and its port."""
    content = yaml.safe_load(find_config("robots", "phantomx").read_text(encoding="utf-8"))
    content["servos"] = {
        "driver": driver,
        "model": model,
        "femur": {"offset_deg": -10},
        "tibia": {"offset_deg": 40},
        **{name: {"id": number} for number, name in enumerate(JOINT_NAMES, start=1)},
    }
    file = folder / "robot.yaml"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    command = [sys.executable, "-u", "-m", "hexctl", "sim", "board", "--bus", driver, "--backend", "mock"]
    process = subprocess.Popen([*command, "--robot", str(file)], stderr=subprocess.PIPE, text=True)
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
