"""Calibration of any servos with a servo map: what is found, what is saved, what an operator may answer."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl import InputError, JointTargets, LegServos, Robot, RobotFaultError, RobotState
from hexctl.backends.base import CalibratedServos
from hexctl.backends.mavlink.mavlink_client import MavlinkServos
from hexctl.backends.mock import MockServos
from hexctl.backends.registry import BackendOptions
from hexctl.control.calibration.operator import CalibrationResult
from hexctl.control.calibration.servo_calibration import calibrate, chosen_joints
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.types import JOINT_NAMES, FloatArray
from tests.backends.fake_time import FakeTime
from tests.backends.mavlink.boards import fitting_file
from tests.control.calibration.hands import Watcher

COXA, FEMUR, TIBIA = (JOINT_NAMES.index(name) for name in ("leg1_coxa", "leg3_femur", "leg2_tibia"))


class Bench(MockServos):
    """Servos on a bench, wired and mounted otherwise than their servo map says.

    Attributes:
        wiring: the servo map that is true.
        failing: whether the robot reports a fault.
        made: all that were made.
    """

    wiring: ServoMap
    failing = False
    made: list["Bench"]

    def __init__(self, robot: Robot, *, servo_map: ServoMap) -> None:
        super().__init__(robot, clock=FakeTime().clock())
        self.servo_map = servo_map
        self._pulses_us = servo_map.raw(robot.stance_angles_rad)
        self.seen_deg: list[FloatArray] = []
        self.made.append(self)

    @property
    def true_deg(self) -> FloatArray:
        """Where the legs really are."""
        return np.degrees(self.wiring.angles_rad(self._pulses_us))

    def remap(self, servo_map: ServoMap) -> None:
        self.servo_map = servo_map

    def read(self) -> RobotState:
        state = super().read()
        return replace(
            state, joint_positions_rad=self.servo_map.angles_rad(self._pulses_us), healthy=not self.failing
        )

    def write(self, targets: JointTargets) -> JointTargets:
        sent = super().write(targets)
        self._pulses_us = self.servo_map.raw(sent.joint_positions_rad)
        self.seen_deg.append(self.true_deg)
        return sent


@pytest.fixture
def made() -> list[Bench]:
    return []


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return fitting_file(tmp_path)


@pytest.fixture(autouse=True)
def bench(tmp_path: Path, made: list[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    """Servos of the user's own: `package.module:Class` is this bench."""
    (tmp_path / "wired").mkdir()
    wiring = {
        "leg1_coxa": {"sign": -1, "offset_deg": 12},
        "leg2_tibia": {"sign": -1, "offset_deg": -84},
    }
    true_map = load_robot_file(fitting_file(tmp_path / "wired", wiring)).servo_map
    monkeypatch.setattr(Bench, "wiring", true_map, raising=False)
    monkeypatch.setattr(Bench, "made", made, raising=False)


def run(file: Path, made: list[Bench], joints: str, **script: list[str]) -> tuple[CalibrationResult, Watcher]:
    watcher = Watcher(lambda: float(made[-1].true_deg[JOINT_NAMES.index(joints)]), **script)  # type: ignore[arg-type]
    return calibrate(file, watcher, backend=f"{__name__}:Bench", joints=joints), watcher


@pytest.mark.parametrize("joint", [COXA, TIBIA])
def test_sign_and_offset_of_any_servos_are_found_and_saved(file: Path, made: list[Bench], joint: int) -> None:
    before = load_robot_file(file).servo_map
    result, _ = run(file, made, JOINT_NAMES[joint])
    assert result.saved == [JOINT_NAMES[joint]]
    assert result.backup is not None
    np.testing.assert_array_equal(load_robot_file(result.backup).servo_map.signs, before.signs)
    found, wiring = load_robot_file(file).servo_map, Bench.wiring
    assert found.signs[joint] == wiring.signs[joint] == -1
    assert found.offsets_deg[joint] == pytest.approx(wiring.offsets_deg[joint], abs=0.5)
    others = np.arange(18) != joint
    np.testing.assert_array_equal(found.signs[others], before.signs[others])
    for seen_deg in made[-1].seen_deg:
        np.testing.assert_allclose(seen_deg[others], made[-1].seen_deg[0][others], atol=0.2)
    steps = np.abs(np.diff([seen_deg[joint] for seen_deg in made[-1].seen_deg]))
    assert steps.max() <= 20.0 * 0.02 + 1e-6  # slowly, whatever is asked for


def test_limits_are_where_the_operator_says(file: Path, made: list[Bench]) -> None:
    run(file, made, "leg3_femur", lower=["-15", "-5", "ok"], upper=["25", "15", "ok"])
    found = load_robot_file(file).servo_map
    assert found.least[FEMUR] == pytest.approx(1500 - 20 * 1000 / 90, abs=5)
    assert found.most[FEMUR] == pytest.approx(1500 + 20 * 1000 / 90, abs=5)


def test_an_operator_who_quits_changes_nothing(file: Path, made: list[Bench]) -> None:
    before = file.read_text()
    result, watcher = run(file, made, "leg1_coxa", measured=["up", "nan", "at home", "at 400", "quit"])
    assert (result.saved, result.backup) == ([], None)
    assert file.read_text() == before
    assert sum("allowed" in text for text in watcher.screen) == 4
    assert not any("-0.0 deg" in text or "-0 deg" in text for text in watcher.screen)


def test_a_requested_stop_ends_it(file: Path, made: list[Bench]) -> None:
    watcher = Watcher(lambda: float(made[-1].true_deg[COXA]))
    asked = iter(range(1000))
    result = calibrate(file, watcher, backend=f"{__name__}:Bench", stop_requested=lambda: next(asked) > 5)
    assert result.saved == []


def test_a_robot_at_fault_ends_it_with_what_is_wrong(
    file: Path, made: list[Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bench, "failing", True)
    with pytest.raises(RobotFaultError):
        run(file, made, "leg1_coxa")


def test_servos_without_a_servo_map_are_refused(file: Path) -> None:
    with pytest.raises(InputError, match="backend"):
        calibrate(file, Watcher(lambda: pytest.fail("asked")), backend="mock")
    options = BackendOptions(robot=load_robot_file(file).robot)
    board: LegServos = MavlinkServos(options.robot, servo_map=options.servo_map, port="/dev/null")
    assert isinstance(board, CalibratedServos)


def test_joints_are_named_alone_or_by_the_leg() -> None:
    assert chosen_joints(None) == list(range(18))
    assert chosen_joints("leg6_tibia, leg1") == [0, 1, 2, 17]
    assert chosen_joints("leg2,leg2_coxa") == [3, 4, 5]
    with pytest.raises(InputError, match="leg7"):
        chosen_joints("leg7")
