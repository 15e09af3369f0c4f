"""Single servos, moved by a few degrees, softly and back again; and which servo moves which joint."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hexctl import InputError, JointTargets, RobotFaultError
from hexctl.backends.bus.bus_map import BusMap, bus_map_of
from hexctl.backends.bus.tools import opened_line, the_servo
from hexctl.backends.clock import WallClock
from hexctl.backends.mock import MockServos
from hexctl.control.calibration.operator import EndedError
from hexctl.control.calibration.servo_assignment import ServoAssignment, assign_servos
from hexctl.control.calibration.servo_trial import TEST_DEG, ServoTrial, softly_powered, try_servo, wiggle
from hexctl.control.calibration.walk_through import exchanged_legs, walk_through
from hexctl.robot.servos.drivers import FAMILIES as DRIVERS
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.register_servos import BusServo
from hexctl.types import JOINT_NAMES
from tests.backends.bus.boards import MODELS, BoardLine, MemoryBus, a_map, memory_bus, stance_counts

#: The joint that is tried, and its id; the servo of the first leg that a walk-through moves.
JOINT, ID = 7, 8
FEMUR_ID = 2


FAMILIES = (*MODELS, ("lx16a", "lx16a"))


class RecordedServos(MockServos):
    """A robot whose joints are recorded."""

    def connect(self) -> None:
        self.seen: list[np.ndarray] = []
        super().connect()

    def write(self, targets: JointTargets) -> JointTargets:
        self.seen.append(targets.joint_positions_rad.copy())
        return super().write(targets)

    def away_deg(self) -> np.ndarray:
        """Recorded angles from the stance, in which it begins, (T, 18)."""
        stance_rad = self.robot.stance_angles_rad
        return np.degrees(np.array([stance_rad, *self.seen]) - stance_rad)


class Bench:
    """A servo on a bus in memory.

    Attributes:
        servo: the one that is tried.
        board: the bus.
        moved: the robot that its servos move.
    """

    def __init__(self, driver: str, model: str) -> None:
        line = BoardLine(a_map(driver, model), kind=RecordedServos)
        assert isinstance(line.robot, RecordedServos)
        self.servo, self.board, self.moved = the_servo(line, driver, ID), line.board, line.robot
        self._time = line.time

    def wiggle(self) -> float:
        return wiggle(self.servo, clock=WallClock(time=self._time))

    def trial(self) -> ServoTrial:
        return try_servo(self.servo, clock=WallClock(time=self._time))


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_a_servo_moves_a_little_and_back_and_no_other_does(driver: str, model: str) -> None:
    bench = Bench(driver, model)
    assert abs(bench.wiggle()) == pytest.approx(5.0, abs=0.3)
    assert not any(each.holds for each in bench.board._servos)
    angles = bench.moved.away_deg()
    farthest = np.abs(angles).max(axis=0)
    assert farthest[JOINT] == pytest.approx(5.0, abs=0.5)
    assert np.delete(farthest, JOINT).max() < 0.5
    assert abs(angles[-1, JOINT]) < 0.5
    steps = np.abs(np.diff(angles[:, JOINT]))
    assert steps.max() < 4.0, "no jump to the end, even if a reading of this thread is late"


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_a_good_servo_follows(driver: str, model: str) -> None:
    bench = Bench(driver, model)
    trial = bench.trial()
    assert trial.followed
    assert trial.servo_id == ID
    assert sorted(trial.moved_deg) == pytest.approx([-TEST_DEG, TEST_DEG], abs=0.5)
    assert trial.error_deg < 1.0
    assert trial.speed_deg_s == pytest.approx(40, rel=0.35)
    assert trial.temperature_c == 35
    assert trial.voltage_v == trial.least_voltage_v == (7.4 if driver == "lx16a" else 12.0)
    assert not any(each.holds for each in bench.board._servos)


def test_torque_speed_and_limits_are_as_they_were() -> None:
    for driver, model in (("dynamixel", "ax12a"), ("dynamixel", "xl430-w250"), ("feetech", "sts3215")):
        bench = Bench(driver, model)
        real = bench.board._servos[JOINT]
        assert isinstance(real, BusServo)
        table = real._table
        registers = [each for each in (table.speed, table.soft_torque, table.least) if each is not None]
        before = [real.number(each) for each in registers]
        with softly_powered(bench.servo) as start:
            assert start == stance_counts(a_map(driver, model))[JOINT]
            assert real.holds
            assert table.speed is not None
            assert table.soft_torque is not None
            assert 0 < real.number(table.speed) <= 61
            assert real.number(table.soft_torque) == pytest.approx(0.4, abs=0.01)
        assert not real.holds
        assert [real.number(each) for each in registers] == before
        real.write(table.torque.address, b"\1")
        bench.wiggle()
        assert real.holds, "it held before"


def test_a_servo_that_must_not_be_moved_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """In another mode, or without a limit of its speed: moving softly is what the operator was told."""
    bench = Bench("dynamixel", "xl430-w250")
    real = bench.board._servos[JOINT]
    assert isinstance(real, BusServo)
    real.memory[11] = 1
    with pytest.raises(RobotFaultError, match="operating mode"):
        bench.wiggle()
    real.memory[11] = 3
    refuses, access = real._refuses, 7
    monkeypatch.setattr(real, "_refuses", lambda at, data: access if at == 112 else refuses(at, data))
    with pytest.raises(RobotFaultError, match="limit"):
        bench.wiggle()
    assert not real.holds
    assert real.number(real._table.soft_torque) == 1.0  # type: ignore[arg-type]
    assert bench.moved.seen == []


def test_a_servo_beyond_its_limits_or_without_room_is_not_moved() -> None:
    for least, most, message in ((3000, 3500, "limits"), (-9, 9, "room")):
        bench = Bench("feetech", "sts3215")
        real = bench.board._servos[JOINT]
        assert isinstance(real, BusServo)
        here = 0 if least > 0 else int(real.number(real._table.position))
        real.set(real._table.least, here + least)
        real.set(real._table.most, here + most)
        with pytest.raises(RobotFaultError, match=message):
            bench.wiggle()
        assert not real.holds


@contextmanager
def seen_bus(bus_map: BusMap, *faults: str) -> Iterator[tuple[MemoryBus, RecordedServos]]:
    """A bus in memory and the joints that its servos move."""
    with memory_bus(bus_map, *faults, kind=RecordedServos) as bus:
        assert isinstance(bus.robot, RecordedServos)
        yield bus, bus.robot


class Watcher:
    """An operator who says which joint moved, after some other answers."""

    def __init__(self, robot: RecordedServos, *first: str, ends_after: int = 99) -> None:
        self._robot, self._first, self._left = robot, list(first), ends_after
        self.asked: list[str] = []
        self.told: list[str] = []
        self._answer: str | None = None

    def tell(self, text: str) -> None:
        self.told.append(text)

    def prompt(self, text: str) -> None:
        self.asked.append(text)
        if "Enter moves it" in text:
            if not self._left:
                raise EndedError
            self._left -= 1
            self._robot.seen.clear()
            self._answer = ""
        elif self._first:
            self._answer = self._first.pop(0)
        else:
            self._answer = JOINT_NAMES[int(np.abs(self._robot.away_deg()).max(axis=0).argmax())]

    def poll(self) -> str | None:
        return self._answer


def test_every_joint_is_found_and_written_to_a_new_file(tmp_path: Path) -> None:
    ids = np.random.default_rng(0).permutation(np.arange(31, 49))
    joints = {name: {"id": int(servo_id)} for name, servo_id in zip(JOINT_NAMES, ids, strict=True)}
    bus_map = bus_map_of(ServosSection.model_validate({"model": "sts3215", **joints}), "feetech")
    output = tmp_path / "servos.yaml"
    with seen_bus(bus_map) as (bus, moved):
        known = ServoAssignment(driver="feetech", port=bus.path, baud=1_000_000, output=output)
        known.resume()
        assign_servos(known, [31, 32, 33], Watcher(moved, "again", "the knee", ends_after=2))
        assert sorted(known.ids.values()) == [31, 32]
        assert not known.finish()
        assert not output.exists()
        # On another day.
        known = ServoAssignment(driver="feetech", port=bus.path, baud=1_000_000, output=output)
        known.resume()
        watcher = Watcher(moved)
        assign_servos(known, sorted(ids.tolist()), watcher)
        assert sum("Enter moves it" in each for each in watcher.asked) == 16
        assert known.finish()
        assert not any(servo.holds for servo in bus.board._servos)
    section = ServosSection.model_validate(yaml.safe_load(output.read_text())["servos"])
    assert bus_map_of(section, "feetech").ids.tolist() == ids.tolist()
    assert (section.driver, section.baud, section.model) == ("feetech", 1_000_000, "sts3215")
    assert [path.name for path in tmp_path.iterdir()] == ["servos.yaml"]


class LegWatcher(Watcher):
    """An operator who says which leg moved, or no to other joints or orders, after some other answers."""

    def prompt(self, text: str) -> None:
        super().prompt(text)
        if self._answer in JOINT_NAMES:
            away_deg = np.abs(self._robot.away_deg())
            moved = np.flatnonzero(away_deg.max(axis=0) > 2)
            order = moved[np.argsort((away_deg[:, moved] > 2).argmax(axis=0))]
            names = [JOINT_NAMES[joint] for joint in order]
            leg = names[0][3]
            right = names == [f"leg{leg}_{kind}" for kind in ("coxa", "femur", "tibia")]
            self._answer = leg if right else "no"
            self._robot.seen.clear()


def test_a_walk_through_sees_each_leg_and_names_exchanged_ones() -> None:
    true = a_map()
    ids = true.ids.copy()
    ids[[0, 1, 2, 6, 7, 8]] = ids[[6, 7, 8, 0, 1, 2]]  # those of legs 1 and 3
    with seen_bus(true) as (bus, moved):
        operator = LegWatcher(moved, "seven", "again")
        seen = walk_through(replace(true, ids=ids), bus.path, 1_000_000, operator)
        assert seen == {1: 3, 2: 2, 3: 1, 4: 4, 5: 5, 6: 6}
        assert exchanged_legs(seen) == "leg 1 of the file moves leg 3, leg 3 of the file moves leg 1"
        assert sum(each.startswith("got 'seven'") for each in operator.asked) == 1
        assert walk_through(true, bus.path, 1_000_000, LegWatcher(moved, ends_after=2)) == {1: 1, 2: 2}
        assert walk_through(true, bus.path, 1_000_000, LegWatcher(moved), stop_requested=lambda: True) == {}
        assert not any(servo.holds for servo in bus.board._servos)
        assert max(np.abs(moved.away_deg()).max(), 0) < 6  # no further than a wiggle


@pytest.mark.parametrize("exchanged", [(3, 6), (5, 8), (3, 4), (4, 5)])
def test_a_walk_through_finds_single_joints_whose_ids_are_exchanged(exchanged: tuple[int, int]) -> None:
    """Coxae or tibiae of two legs, and two joints of one leg."""
    true = a_map()
    ids = true.ids.copy()
    ids[list(exchanged)] = ids[list(exchanged)[::-1]]
    with seen_bus(true) as (bus, moved):
        seen = walk_through(replace(true, ids=ids), bus.path, 1_000_000, LegWatcher(moved))
    legs = {joint // 3 + 1 for joint in exchanged}
    assert {leg for leg, real in seen.items() if real != leg} == legs
    assert all(f"leg {leg} of the file moves no leg" in exchanged_legs(seen) for leg in legs)


def test_a_leg_is_seen_once() -> None:
    true = a_map()
    with seen_bus(true) as (bus, moved):
        operator = LegWatcher(moved, "2", "2", "1", ends_after=2)
        assert walk_through(true, bus.path, 1_000_000, operator) == {1: 2, 2: 1}
    assert sum(each.startswith("leg 2 has moved before") for each in operator.asked) == 1


@pytest.mark.parametrize("holds", [False, True])
@pytest.mark.parametrize("command", ["walk-through", "identify"])
@pytest.mark.parametrize(("driver", "model"), [*FAMILIES, ("hiwonder", "hts35h")])
def test_a_stop_ends_a_movement_where_the_joint_is(
    driver: str, model: str, command: str, holds: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the middle of it: the joint stays there, and is limp or holds as before."""
    monkeypatch.setitem(DRIVERS, "hiwonder", "hexctl_hiwonder.family:HIWONDER")
    true = a_map(driver, model)
    moves = FEMUR_ID if command == "identify" else 1  # the first that does
    with seen_bus(true) as (bus, moved):
        if holds:
            with opened_line(bus.path, true.family.bauds[0], true.family) as line:
                assert the_servo(line, driver, moves).set_torque(on=True)
        moved.seen.clear()

        def stop() -> bool:
            return bool(np.abs(moved.away_deg()).max() > 2)

        operator = (Watcher if command == "identify" else LegWatcher)(moved)
        if command == "identify":
            known = ServoAssignment(driver=driver, port=bus.path, baud=true.family.bauds[0])
            assign_servos(known, [FEMUR_ID, 5], operator, consent=True, stop_requested=stop)
            assert known.ids == {}
        else:
            seen = walk_through(
                true, bus.path, true.family.bauds[0], operator, consent=True, stop_requested=stop
            )
            assert seen == {}
        bus.time.sleep(1.0)
        bus.speak(b"")
        away_deg = np.abs(moved.away_deg()[:, moves - 1])
        assert 2 < away_deg.max() < 3.5
        assert away_deg[-1] == pytest.approx(away_deg.max(), abs=1.0)
        assert bus.board._servos[moves - 1].holds is holds
    assert operator.asked == []


def test_a_joint_has_one_servo_and_a_servo_may_belong_to_none() -> None:
    with seen_bus(a_map(), "mute:1:tibia") as (bus, moved):
        known = ServoAssignment(driver="feetech", port=bus.path, baud=1_000_000)
        watcher = Watcher(moved, "1 coxa", "1c", "none")
        assign_servos(known, [1, 2, 3], watcher)
    assert known.ids == {"leg1_coxa": 1}
    assert any(each.startswith("leg1_coxa has id 1 already") for each in watcher.asked)
    assert watcher.told[-1].startswith("id 3: no servo")
    assert known.section().splitlines()[-1] == "  leg1_coxa: {id: 1}"


def test_a_servo_moves_by_a_yes_or_with_consent_and_is_left_out_by_a_skip_alone() -> None:
    class Hesitant(Watcher):
        """Answers the question before a servo moves in words."""

        words: tuple[str, ...] = ("n", "y", "S", "jes", "yes")

        def prompt(self, text: str) -> None:
            super().prompt(text)
            if "Enter" in text:
                self._answer, self.words = self.words[0], self.words[1:]

    with seen_bus(a_map()) as (bus, moved):
        known = ServoAssignment(driver="feetech", port=bus.path, baud=1_000_000)
        watcher = Hesitant(moved)
        assign_servos(known, [1, 5, 9], watcher)
        assert known.ids == {"leg1_coxa": 1, "leg3_tibia": 9}
        assert [each[:9] for each in watcher.asked if each.startswith("got")] == ["got 'n'; ", "got 'jes'"]
        known, trusting = ServoAssignment(driver="feetech", port=bus.path, baud=1_000_000), Watcher(moved)
        moved.seen.clear()
        assign_servos(known, [5], trusting, consent=True)
    assert known.ids == {"leg2_femur": 5}
    assert len(trusting.asked) == 1


def test_a_file_that_there_is_is_never_written(tmp_path: Path) -> None:
    output = tmp_path / "servos.yaml"
    output.write_text("mine\n")
    known = ServoAssignment(driver="feetech", port="/dev/nothing", baud=1_000_000, output=output)
    with pytest.raises(InputError, match="output"):
        known.resume()
    output.unlink()
    for draft in ("mine", "servos: {driver: lx16a}"):
        (tmp_path / "servos.yaml.part").write_text(draft)
        with pytest.raises(InputError):
            known.resume()
