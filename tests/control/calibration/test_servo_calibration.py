"""Calibration over the real drivers, on simulated buses and boards: by hand with feedback, jogged without."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl import InputError, JointTargets, RobotState
from hexctl.backends.mock import MockServos
from hexctl.cli.main import exit_code
from hexctl.control.calibration.servo_calibration import calibrate
from hexctl.robot.configs import read_mapping
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.robot.servos.pwm_map import pwm_map_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.bus_board import BusBoard
from hexctl.types import FloatArray
from tests.backends.bus.boards import memory_bus
from tests.backends.pwm.boards import memory_servo2040, pca9685_board
from tests.control.calibration.hands import ENDS_DEG, Hands, Watcher
from tests.robots import edited_file, put


class LimpRobot(MockServos):
    """A robot behind a bus, whose joints a test moves once they are limp, and that counts what motors do."""

    moved = 0

    def write(self, targets: JointTargets) -> JointTargets:
        self.moved += 1
        return super().write(targets)

    def read(self) -> RobotState:
        return replace(super().read(), measured=True)

    def hold(self, true_deg: FloatArray) -> None:
        self._positions_rad = np.radians(true_deg)


DRIVERS = {
    "dynamixel": {"model": "ax12a", "tibia": {"sign": -1, "offset_deg": 30}},
    "feetech": {"leg1_coxa": {"sign": -1, "offset_deg": 12}, "tibia": {"offset_deg": 30}},
    "lx16a": {"femur": {"sign": -1, "offset_deg": -9}, "tibia": {"offset_deg": 30}},
}


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_bus_is_calibrated_by_hand_and_left_limp(driver: str, tmp_path: Path) -> None:
    true = bus_map_of(ServosSection.model_validate(DRIVERS[driver]), driver)
    with memory_bus(true, kind=LimpRobot) as bus:
        robot = bus.robot
        assert isinstance(robot, LimpRobot)
        section = {"driver": driver, "model": true.models[0].name, "port": bus.path}
        file = edited_file(tmp_path, put("servos", {**section, "if_computer_dies": "hold"}), base="phantomx")
        hands = Hands(robot.hold)
        result = calibrate(file, hands, joints="leg1")
        assert result.saved == ["leg1_coxa", "leg1_femur", "leg1_tibia"]
        assert not _holding(bus.board)
        assert robot.moved == 0
    found = bus_map_of(load_robot_file(file).content.servos, driver)
    np.testing.assert_array_equal(found.signs[:3], true.signs[:3])
    count_deg = 1 / float(true.per_deg[0])
    np.testing.assert_allclose(found.offsets_deg[:3], true.offsets_deg[:3], atol=count_deg)
    ends = np.array([true.raw(np.radians(np.full(18, end))) for end in ENDS_DEG])
    np.testing.assert_allclose(found.least[:3], ends.min(axis=0)[:3], atol=1.5)
    np.testing.assert_allclose(found.most[:3], ends.max(axis=0)[:3], atol=1.5)
    kept = read_mapping(file)["servos"]
    assert (kept["port"], kept["model"], kept["if_computer_dies"]) == (
        section["port"],
        section["model"],
        "hold",
    )


def _holding(board: BusBoard) -> bool:
    return bool(board._family.holds().any())


@pytest.mark.parametrize("driver", ["servo2040", pytest.param("pca9685", marks=pytest.mark.realtime)])
def test_a_board_of_hobby_servos_is_calibrated_by_their_motors(
    driver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the command, whose questions the watcher answers."""
    mounted: dict[str, Any] = {"tibia": {"offset_deg": 40}, "leg1_coxa": {"id": 7}, "leg3_femur": {"id": 0}}
    true = {**mounted, "leg1_coxa": {"id": 7, "sign": -1, "offset_deg": 12}}
    true_map = pwm_map_of(ServosSection.model_validate(true), driver)
    make: Any = memory_servo2040 if driver == "servo2040" else pca9685_board
    with make(pwm_map=true_map) as board:
        section = {**mounted, "driver": driver, "port": board.path, "if_computer_dies": "hold"}
        file = edited_file(tmp_path, put("servos", section))

        def true_deg() -> float:
            by_output = board.board.pulses_us if driver == "servo2040" else board.pulses_us()
            pulses_us = by_output[true_map.outputs] if driver == "servo2040" else by_output
            return float(np.degrees(true_map.angles_rad(np.asarray(pulses_us)))[0])

        # A PCA9685 makes pulses in steps of half a degree.
        watcher = Watcher(true_deg, good_deg=0.5, patience=9, upper=["20", "ok"], lower=["ok"])
        monkeypatch.setattr("hexctl.cli.prompts.CalibrationPrompt", lambda: watcher)
        monkeypatch.setattr("hexctl.cli.prompts.can_answer", lambda: True)
        assert exit_code(["calibrate", str(file), "--joints", "leg1_coxa"]) == 0
    assert f"saved leg1_coxa in {file}" in capsys.readouterr().err
    assert any("output 7" in line for line in watcher.screen)
    kept = read_mapping(file)["servos"]
    found = kept.pop("leg1_coxa")
    assert (found["id"], found["sign"]) == (7, -1)
    assert found["offset_deg"] == pytest.approx(12, abs=0.8)
    assert found["max_us"] == pytest.approx(1500 + 1000 / 90 * 12, abs=8)  # the ends turn with the sign
    assert found["min_us"] == pytest.approx(1500 + 1000 / 90 * -8, abs=8)
    section.pop("leg1_coxa")
    assert kept == section


def test_a_driver_is_not_calibrated_as_another(tmp_path: Path) -> None:
    file = edited_file(tmp_path, put("servos", {"driver": "feetech", "port": "/dev/x"}), base="phantomx")
    with pytest.raises(InputError):
        calibrate(file, Hands(lambda _: None), backend="mavlink")
