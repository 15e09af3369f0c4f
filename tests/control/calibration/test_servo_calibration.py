"""Calibration: over the real drivers on simulated buses and boards, and of any servos with a servo map."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl import InputError, JointTargets, LegServos, Robot, RobotFaultError, RobotState
from hexctl.backends.base import CalibratedServos
from hexctl.backends.bus.bus_map import BusMap, bus_map_of
from hexctl.backends.mavlink.mavlink_client import MavlinkServos
from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.pulse_board import pwm_map_of
from hexctl.backends.registry import BackendOptions
from hexctl.cli.main import exit_code
from hexctl.control.calibration.operator import CalibrationResult
from hexctl.control.calibration.servo_calibration import calibrate, chosen_joints
from hexctl.robot.configs import read_mapping
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import JOINT_NAMES, FloatArray
from tests.backends.bus.boards import memory_bus
from tests.backends.fake_time import FakeTime
from tests.backends.mavlink.boards import fitting_file
from tests.backends.pwm.boards import memory_board, pca9685_board
from tests.control.calibration.hands import ENDS_DEG, Hands, Watcher
from tests.control.posed import readings
from tests.robots import edited_file, put, with_ids


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
        ids = with_ids({**section, "if_computer_dies": "hold"})
        file = edited_file(tmp_path, put("servos", ids), base="phantomx")
        hands = Hands(robot.hold)
        result = calibrate(file, hands, joints="leg1")
        assert result.saved == ["leg1_coxa", "leg1_femur", "leg1_tibia"]
        assert not bus.board._family.holds().any()
        assert robot.moved == 0
    found = bus_map_of(load_robot_file(file).content.servos, driver)
    np.testing.assert_array_equal(found.signs[:3], true.signs[:3])
    count_deg = 1 / float(true.per_deg[0])
    np.testing.assert_allclose(found.offsets_deg[:3], true.offsets_deg[:3], atol=count_deg)
    ends = np.array([true.raw(np.radians(np.full(18, end))) for end in ENDS_DEG])
    np.testing.assert_allclose(found.least[:3], ends.min(axis=0)[:3], atol=1.5)
    np.testing.assert_allclose(found.most[:3], ends.max(axis=0)[:3], atol=1.5)
    kept = read_mapping(file)["servos"]
    assert kept["if_computer_dies"] == "hold"
    assert {**kept, **section} == kept


@pytest.mark.parametrize(
    "driver", ["servo2040", "maestro", "ssc32", pytest.param("pca9685", marks=pytest.mark.realtime)]
)
def test_a_board_of_hobby_servos_is_calibrated_by_their_motors(
    driver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the command, whose questions the watcher answers."""
    mounted: dict[str, Any] = {"tibia": {"offset_deg": 40}, "leg1_coxa": {"id": 7}, "leg3_femur": {"id": 0}}
    true = {**mounted, "leg1_coxa": {"id": 7, "sign": -1, "offset_deg": 12}}
    true_map = pwm_map_of(ServosSection.model_validate(true), driver)
    made: Any = pca9685_board(pwm_map=true_map) if driver == "pca9685" else memory_board(true_map)
    with made as board:
        section = {**mounted, "driver": driver, "port": board.path, "if_computer_dies": "hold"}
        file = edited_file(tmp_path, put("servos", section))

        def true_deg() -> float:
            twin = board if driver == "pca9685" else board.board
            pulses_us = twin.pulses_us[true_map.outputs] if driver == "servo2040" else twin.pulses_us()
            return float(np.degrees(true_map.angles_rad(np.asarray(pulses_us)))[0])

        # Each step adds to the one before; the lower end, -20 deg, comes first.
        ends = {"upper": ["25", "15", "ok"], "lower": ["-15", "-5", "ok"]}
        # A PCA9685 makes pulses in steps of half a degree.
        watcher = Watcher(true_deg, good_deg=0.5, patience=9, **ends)
        monkeypatch.setattr("hexctl.cli.prompts.CalibrationPrompt", lambda: watcher)
        monkeypatch.setattr("hexctl.cli.prompts.can_answer", lambda: True)
        assert exit_code(["calibrate", str(file), "--joints", "leg1_coxa"]) == 0
    assert f"saved leg1_coxa in {file}" in capsys.readouterr().err
    assert any(true_map.servo_name(0) in line for line in watcher.screen)
    kept = read_mapping(file)["servos"]
    found = kept.pop("leg1_coxa")
    assert (found["id"], found["sign"]) == (7, -1)
    assert found["offset_deg"] == pytest.approx(12, abs=0.8)
    assert found["max_us"] == pytest.approx(1500 + 1000 / 90 * 32, abs=8)  # the ends turn with the sign
    assert found["min_us"] == pytest.approx(1500 + 1000 / 90 * -8, abs=8)
    section.pop("leg1_coxa")
    assert kept == section


def test_a_driver_is_not_calibrated_as_another(tmp_path: Path) -> None:
    file = edited_file(tmp_path, put("servos", {"driver": "feetech", "port": "/dev/x"}), base="phantomx")
    with pytest.raises(InputError):
        calibrate(file, Hands(lambda _: None), backend="mavlink")


# Jogged: any servos with a servo map, moved by their motors


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
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Bench]:
    """Every bench that a test makes; all are wired otherwise than the robot file says."""
    made: list[Bench] = []
    (tmp_path / "wired").mkdir()
    wiring = {"leg1_coxa": {"sign": -1, "offset_deg": 12}, "leg2_tibia": {"sign": -1, "offset_deg": -84}}
    true_map = load_robot_file(fitting_file(tmp_path / "wired", wiring)).servo_map
    monkeypatch.setattr(Bench, "wiring", true_map, raising=False)
    monkeypatch.setattr(Bench, "made", made, raising=False)
    return made


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return fitting_file(tmp_path)


def run(file: Path, made: list[Bench], joints: str, **script: list[str]) -> tuple[CalibrationResult, Watcher]:
    watcher = Watcher(lambda: float(made[-1].true_deg[JOINT_NAMES.index(joints)]), **script)  # type: ignore[arg-type]
    return calibrate(file, watcher, backend=f"{__name__}:Bench", joints=joints), watcher


@pytest.mark.parametrize("name", ["leg1_coxa", "leg2_tibia"])
def test_sign_and_offset_of_any_servos_are_found_and_saved(file: Path, made: list[Bench], name: str) -> None:
    before, joint = load_robot_file(file).servo_map, JOINT_NAMES.index(name)
    result, _ = run(file, made, name)
    assert result.saved == [name]
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


def test_an_operator_who_quits_changes_nothing(file: Path, made: list[Bench]) -> None:
    before = file.read_text()
    result, watcher = run(file, made, "leg1_coxa", measured=["up", "nan", "at home", "at 400", "quit"])
    assert (result.saved, result.backup) == ([], None)
    assert file.read_text() == before
    assert sum("allowed" in text for text in watcher.screen) == 4
    assert not any("-0.0 deg" in text or "-0 deg" in text for text in watcher.screen)


def test_limits_that_exclude_the_stance_are_refused_at_the_joint(file: Path, made: list[Bench]) -> None:
    before = load_robot_file(file).servo_map
    result, watcher = run(
        file, made, "leg1_femur", lower=["-40", "ok"], upper=["20", "ok"]
    )  # it stands at 5 deg
    assert result.saved == ["leg1_femur"]
    assert sum("leg1_femur: got servo limits" in text for text in watcher.screen) == 1
    found = load_robot_file(file).servo_map
    assert (found.least[1], found.most[1]) == (before.least[1], before.most[1])


def test_a_joint_that_cannot_stand_is_not_saved(file: Path, made: list[Bench]) -> None:
    narrow = fitting_file(file.parent, {"leg1_femur": {"min_us": 1000, "max_us": 1400}})
    text = narrow.read_text()
    skipped = {part: ["skip"] for part in ("Enter to move it", "if you measured")}
    result, watcher = run(narrow, made, "leg1_femur", **skipped)
    assert result.saved == []
    assert any("leg1_femur: got servo limits" in text for text in watcher.screen)
    assert narrow.read_text() == text


def test_a_requested_stop_ends_it(file: Path, made: list[Bench]) -> None:
    watcher = Watcher(lambda: float(made[-1].true_deg[0]))
    asked = iter(range(1000))
    result = calibrate(file, watcher, backend=f"{__name__}:Bench", stop_requested=lambda: next(asked) > 5)
    assert result.saved == []


def test_a_busy_computer_does_not_end_it(file: Path, made: list[Bench]) -> None:
    watcher, polls = Watcher(lambda: float(made[-1].true_deg[0])), iter(range(10_000))

    def stands_still() -> bool:
        if next(polls) % 40 == 20:
            made[-1].clock.time.sleep(1.5)
        return False

    result = calibrate(
        file, watcher, backend=f"{__name__}:Bench", joints="leg1_coxa", stop_requested=stands_still
    )
    assert result.saved == ["leg1_coxa"]
    assert load_robot_file(file).servo_map.signs[0] == Bench.wiring.signs[0]


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


# By hand: what is read of limp servos, what is saved, and that no motor moves


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
def bus_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    true_map = bus_map_of(ServosSection.model_validate(TRUE), "feetech")
    monkeypatch.setattr(LimpBench, "wiring", true_map, raising=False)
    return edited_file(tmp_path, put("servos", dict(SECTION)), base="phantomx")


def hold(true_deg: FloatArray) -> None:
    if hasattr(LimpBench, "made"):
        LimpBench.made.true_deg = true_deg.copy()


def run_by_hand(bus_file: Path, joints: str, **script: list[str]) -> tuple[CalibrationResult, Hands]:
    hands = Hands(hold, **script)
    result = calibrate(
        bus_file,
        hands,
        backend=f"{__name__}:LimpBench",
        joints=joints,
        stop_requested=lambda: hands.interrupted,
    )
    assert list(LimpBench.made.sent) == []  # nothing ever moves by motor
    return result, hands


def found_in(bus_file: Path) -> BusMap:
    return bus_map_of(load_robot_file(bus_file).content.servos, "feetech")


def test_an_angle_that_was_measured_counts_in_place_of_the_reference(bus_file: Path) -> None:
    _, hands = run_by_hand(bus_file, "leg1_tibia", leg_1_is_in_it=["at 200 deg", "at -30"])
    true_deg = np.linspace(-12, 14, 18)[2]
    counts = LimpBench.wiring.raw(np.radians(np.full(18, true_deg)))
    assert np.degrees(found_in(bus_file).angles_rad(counts))[2] == pytest.approx(-30, abs=0.1)
    for words in ("quit ends", "level the body and put the leg into this pose", "got 'at 200 deg'"):
        assert any(words in line for line in hands.screen)


def test_what_is_skipped_stays_as_it_was_and_the_direction_is_asked_for(bus_file: Path) -> None:
    run_by_hand(bus_file, "leg2", as_far_as=["skip", "skip", "", "skip"], direction=["", "skip"])
    found = found_in(bus_file)
    assert (found.least[3:6].tolist(), found.most[3:6].tolist()) == ([0, 0, 0], [4095, 4095, 4095])
    assert found.signs[3] == -1
    assert found.signs[4] == 1  # skipped
    assert found.offsets_deg[3:5] == pytest.approx([0, -20], abs=0.1)
    run_by_hand(bus_file, "leg3_femur", leg_3_is_in_it=["skip"])
    found = found_in(bus_file)
    assert (found.signs[7], found.offsets_deg[7]) == (1, 0)
    assert found.least[7] > 0


def test_ends_that_exclude_the_stance_are_asked_for_again(
    bus_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.control.calibration.hands.ENDS_DEG", (-92.0, 10.0))  # it stands at 33 deg
    _, hands = run_by_hand(bus_file, "leg1_femur", as_far_as=["", "", "skip"], direction=["skip"])
    assert sum("leg1_femur: got servo limits" in text for text in hands.screen) == 1
    found = found_in(bus_file)
    assert (found.least[1], found.most[1]) == (0, 4095)


@pytest.mark.parametrize(
    ("part", "key"),
    [("Enter_when_ready", "#"), ("leg_2_is_in_it", "quit"), ("as_far_as", "#"), ("now_", "quit")],
)
def test_whoever_ends_at_any_prompt_keeps_what_is_done_and_goes_on_later(
    bus_file: Path, part: str, key: str
) -> None:
    script = {part: ["", "", "", key] if part in ("as_far_as", "now_") else [key]}
    result, _ = run_by_hand(bus_file, "leg1,leg2", **script)
    done = {"Enter_when_ready": 0, "leg_2_is_in_it": 3, "as_far_as": 1, "now_": 3}[part]
    assert result.saved == list(JOINT_NAMES[:done])
    assert LimpBench.made.limp == (part != "Enter_when_ready")
    run_by_hand(bus_file, "leg2")
    found = found_in(bus_file)
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
    flaw: dict[str, Any], seen: str, bus_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in flaw.items():
        monkeypatch.setattr(LimpBench, name, value)
    result, hands = run_by_hand(bus_file, "leg1", leg_1_is_in_it=["", "quit"])
    assert result.saved == []
    assert any(seen in line for line in hands.screen)


def test_counts_that_begin_anew_within_the_travel_are_noticed(
    bus_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The horn sits so that the count passes its end between the pose and the upper end of the travel."""
    raw = BusMap.raw
    true_map = bus_map_of(ServosSection.model_validate({"femur": {"offset_deg": 150}}), "feetech")
    monkeypatch.setattr(LimpBench, "wiring", true_map)
    monkeypatch.setattr(BusMap, "raw", lambda self, angles: np.mod(raw(self, angles), 4096))
    result, hands = run_by_hand(bus_file, "leg1_femur", now_up=["", "", "quit"])
    assert result.saved == []
    assert any("turn the servo by a quarter" in line for line in hands.screen)


def test_a_fault_of_the_robot_ends_it_with_what_is_saved(
    bus_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LimpBench, "fault", "the port has gone")
    with pytest.raises(RobotFaultError):
        run_by_hand(bus_file, "leg1")
