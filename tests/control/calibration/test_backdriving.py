"""Calibration by hand: what is read of limp servos, what is saved, and that nothing is moved by a motor."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl import Robot, RobotFaultError, RobotState
from hexctl.backends.mock import MockServos
from hexctl.control.calibration.operator import CalibrationResult
from hexctl.control.calibration.servo_calibration import calibrate
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.bus_map import BusMap, bus_map_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import JOINT_NAMES, FloatArray
from tests.backends.fake_time import FakeTime
from tests.control.calibration.hands import Hands
from tests.control.posed import readings
from tests.robots import edited_file, put

#: How the servos are really mounted; the file knows none of it.
TRUE = {
    "coxa": {"sign": -1},
    "leg1_coxa": {"offset_deg": 12},
    "femur": {"offset_deg": -20},
    "leg1_femur": {"sign": -1, "offset_deg": 31},
    "tibia": {"sign": -1, "offset_deg": 8},
}


#: What the file says of the bus, and must keep.
SECTION = {"driver": "feetech", "port": "/dev/ttyUSB7", "baud": 500000, "leg1_coxa": {"id": 40}}


class LimpBench(MockServos):
    """Servos that tell their counts, moved by the hands of a test once they are limp.

    Attributes:
        wiring: the map that is true.
        made: the last that was made.
        shaking: counts by which a measurement differs from the next.
        mute: joints that are not heard.
        fault: what the robot reports, or None.
    """

    wiring: BusMap
    made: "LimpBench"
    shaking = 1.0
    mute: tuple[int, ...] = ()
    fault: str | None = None

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot, clock=FakeTime().clock())
        self.servo_map = bus_map_of(ServosSection.model_validate(SECTION), "feetech")
        self.true_deg: FloatArray = np.degrees(robot.stance_angles_rad)
        self._reads = 0
        type(self).made = self

    def remap(self, servo_map: Any) -> None:
        raise AssertionError("nothing holds, so there is nothing to remap")

    def read(self) -> RobotState:
        state = super().read()
        self._reads += 1
        counts = np.rint(self.wiring.raw(np.radians(self.true_deg))) + self.shaking * (self._reads % 2 - 0.5)
        ages_s = np.array([np.inf if joint in self.mute else 0.01 for joint in range(18)])
        return replace(
            state,
            joint_positions_rad=self.servo_map.angles_rad(counts),
            measured=True,
            healthy=self.fault is None,
            fault=self.fault,
            servos=readings(ages_s=ages_s),
        )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return edited_file(tmp_path, put("servos", dict(SECTION)), base="phantomx")


@pytest.fixture(autouse=True)
def bench(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        LimpBench, "wiring", bus_map_of(ServosSection.model_validate(TRUE), "feetech"), raising=False
    )


def hold(true_deg: FloatArray) -> None:
    if hasattr(LimpBench, "made"):
        LimpBench.made.true_deg = true_deg.copy()


def run(file: Path, joints: str | None = None, **script: list[str]) -> tuple[CalibrationResult, Hands]:
    hands = Hands(hold, **script)
    result = calibrate(
        file,
        hands,
        backend=f"{__name__}:LimpBench",
        joints=joints,
        stop_requested=lambda: hands.interrupted,
    )
    assert list(LimpBench.made.sent) == []  # nothing ever moves by motor
    return result, hands


def found_in(file: Path) -> BusMap:
    return bus_map_of(load_robot_file(file).content.servos, "feetech")


def test_an_angle_that_was_measured_counts_in_place_of_the_reference(file: Path) -> None:
    _, hands = run(file, "leg1_tibia", leg_1_is_in_it=["at 200 deg", "at -30"])
    true_deg = np.linspace(-12, 14, 18)[2]
    counts = LimpBench.wiring.raw(np.radians(np.full(18, true_deg)))
    assert np.degrees(found_in(file).angles_rad(counts))[2] == pytest.approx(-30, abs=0.1)
    assert any("got 'at 200 deg'" in line for line in hands.screen)


def test_what_is_skipped_stays_as_it_was_and_the_direction_is_asked_for(file: Path) -> None:
    run(file, "leg2", as_far_as=["skip", "skip", "", "skip"], direction=["", "skip"])
    found = found_in(file)
    assert (found.least[3:6].tolist(), found.most[3:6].tolist()) == ([0, 0, 0], [4095, 4095, 4095])
    assert found.signs[3] == -1
    assert found.signs[4] == 1  # skipped
    assert found.offsets_deg[3:5] == pytest.approx([0, -20], abs=0.1)
    run(file, "leg3_femur", leg_3_is_in_it=["skip"])
    found = found_in(file)
    assert (found.signs[7], found.offsets_deg[7]) == (1, 0)
    assert found.least[7] > 0


@pytest.mark.parametrize(
    ("part", "key"),
    [("Enter_when_ready", "#"), ("leg_2_is_in_it", "quit"), ("as_far_as", "#"), ("now_", "quit")],
)
def test_whoever_ends_at_any_prompt_keeps_what_is_done_and_goes_on_later(
    file: Path, part: str, key: str
) -> None:
    script = {part: ["", "", "", key] if part in ("as_far_as", "now_") else [key]}
    result, _ = run(file, "leg1,leg2", **script)
    done = {"Enter_when_ready": 0, "leg_2_is_in_it": 3, "as_far_as": 1, "now_": 3}[part]
    assert result.saved == list(JOINT_NAMES[:done])
    assert LimpBench.made.limp == (part != "Enter_when_ready")
    run(file, "leg2")
    found = found_in(file)
    np.testing.assert_array_equal(found.signs[3:6], LimpBench.wiring.signs[3:6])
    np.testing.assert_array_equal(found.signs[:done], LimpBench.wiring.signs[:done])


@pytest.mark.parametrize(
    ("flaw", "seen"),
    [
        ({"shaking": 40.0}, "leg1_coxa, leg1_femur, leg1_tibia moves"),
        ({"mute": (1,)}, "leg1_femur is not heard"),
    ],
)
def test_a_joint_that_moves_or_is_not_heard_is_not_read(
    flaw: dict[str, Any], seen: str, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in flaw.items():
        monkeypatch.setattr(LimpBench, name, value)
    result, hands = run(file, "leg1", leg_1_is_in_it=["", "quit"])
    assert result.saved == []
    assert any(seen in line for line in hands.screen)


def test_counts_that_begin_anew_within_the_travel_are_noticed(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The horn sits so that the count passes its end between the pose and the upper end of the travel."""
    raw = BusMap.raw
    monkeypatch.setattr(
        LimpBench,
        "wiring",
        bus_map_of(ServosSection.model_validate({"femur": {"offset_deg": 150}}), "feetech"),
    )
    monkeypatch.setattr(BusMap, "raw", lambda self, angles: np.mod(raw(self, angles), 4096))
    result, hands = run(file, "leg1_femur", now_up=["", "", "quit"])
    assert result.saved == []
    assert any("turn the servo by a quarter" in line for line in hands.screen)


def test_a_robot_that_has_gone_ends_it_with_what_is_saved(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LimpBench, "fault", "the port has gone")
    with pytest.raises(RobotFaultError):
        run(file, "leg1")
