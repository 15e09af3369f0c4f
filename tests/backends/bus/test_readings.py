"""Readings that are believed, what they say of the line, and what is said of servos in abnormal states."""

import random
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.bus.families.registers import Register
from hexctl.backends.bus.line_condition import LineCondition
from hexctl.backends.bus.readings import BelievedReadings
from hexctl.backends.bus.servo_bus import AnswerShares, Report, ServoBus
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.clock import WallClock
from hexctl.errors import RobotFaultError
from hexctl.simulators.lx16a_servos import SimulatedLx16aServo
from hexctl.simulators.register_servos import BusServo
from hexctl.types import ServoReadings
from tests.backends.bus.boards import BoardLine, a_map, memory_bus, servos_on
from tests.backends.fake_time import FakeTime
from tests.backends.standing import until
from tests.robots import shipped


def _report(at_s: float, position: float, *, joint: int = 4, temperature_c: float = 40.0) -> Report:
    return Report(
        index=joint,
        at_s=at_s,
        position=position,
        effort=0.1,
        current_a=np.nan,
        voltage_v=12.0,
        temperature_c=temperature_c,
        error="",
    )


def _new() -> BelievedReadings:
    return BelievedReadings(np.full(18, 2000.0), np.full(18, 11.4))


def _readings(position: float = 2000) -> BelievedReadings:
    """Readings that have begun, at a position of joint 4."""
    readings = _new()
    for at_s in (-0.04, -0.02):
        readings.take([_report(at_s, position)])
    return readings


def test_the_first_position_is_believed_once_two_agree() -> None:
    """A robot begins to move from there."""
    readings = _new()
    for tick, position in enumerate((900, 2000, 400, 405)):
        assert not readings.trusted[4]
        assert np.isnan(readings.positions[4])
        readings.take([_report(0.02 * tick, position)])
    assert readings.positions[4] == 405
    assert np.flatnonzero(readings.trusted).tolist() == [4]
    readings.distrust()
    readings.take([_report(0.1, 3000)])
    assert (readings.positions[4], readings.trusted[4]) == (405, False)
    readings.take([_report(0.12, 3002)])
    assert (readings.positions[4], readings.trusted[4]) == (3002, True)


def test_one_wild_position_is_not_believed_and_three_in_a_row_are() -> None:
    readings = _readings()
    for tick, position in enumerate((2000, 2010, 4000, 2020)):
        readings.take([_report(0.02 * tick, position)])
        assert readings.servos(0.02 * tick).ages_s[4] < ServoBus.stale_s / 4
    assert readings.positions[4] == 2020
    assert readings.implausible == 1
    for tick, position in enumerate((4000, 4005, 4010)):
        readings.take([_report(0.1 + 0.02 * tick, position)])
        assert readings.positions[4] == (2020 if tick < 2 else 4010)
    assert np.isnan(np.delete(readings.positions, 4)).all()


def test_a_position_is_believed_within_twice_the_speed_of_the_joint_and_four_degrees() -> None:
    reach = round(2 * 2000 * 0.02 + 4 * 11.4)
    for step, believed in ((reach - 1, True), (reach + 1, False)):
        readings = _readings(2000)
        readings.take([_report(0.0, 2000 + step)])
        assert (readings.positions[4] != 2000) == believed
    readings.take([_report(1.0, 4000)])
    assert readings.positions[4] == 4000, "after a second it may be anywhere"


def test_wild_positions_that_differ_are_never_believed_and_the_joint_becomes_stale() -> None:
    readings = _readings(250)
    for tick in range(round(ServoBus.stale_s / 0.02) + 1):
        at_s = 0.02 * tick
        readings.take([_report(at_s, 500.0 * (1 + tick % 4))])
        assert readings.positions[4] == 250
    assert readings.heard_at_s[4] == at_s
    assert readings.servos(at_s).ages_s[4] > ServoBus.stale_s


def test_one_temperature_that_is_wrong_makes_no_servo_hot() -> None:
    readings = _readings(100)
    for tick, degrees in enumerate((40, 77, 41, 70, 40)):
        readings.take([_report(0.02 * tick, 100, temperature_c=degrees)])
        assert readings.servos(0.1).temperatures_c[4] <= 41
    for tick in range(3):
        readings.take([_report(0.2 + 0.02 * tick, 100, temperature_c=72)])
    assert readings.servos(0.3).temperatures_c[4] == 72
    first = _new()
    for tick, degrees in enumerate((126, 40, 41)):
        first.take([_report(0.02 * tick, 100, temperature_c=degrees)])
        assert not first.servos(0.1).temperatures_c[4] > 41
    assert first.servos(0.1).temperatures_c[4] == 41


NONE = np.zeros(18, dtype=bool)


def _servos(volts: float = 12.0) -> ServoReadings:
    unknown = np.full(18, np.nan)
    return ServoReadings(
        ages_s=np.zeros(18),
        efforts=unknown,
        currents_a=unknown,
        voltages_v=np.full(18, volts),
        temperatures_c=unknown,
        errors=("",) * 18,
    )


def _condition(model: str = "ax12a") -> tuple[LineCondition, AnswerShares, FakeTime]:
    shares, clock = AnswerShares(), FakeTime(0.0)
    return LineCondition(a_map("dynamixel", model), shares, time=clock), shares, clock


def test_a_cable_that_damages_one_answer_in_eight_is_told() -> None:
    condition, shares, _ = _condition()
    rng = random.Random(3)
    for _ in range(400):
        shares.take(range(18), [joint for joint in range(18) if joint != 7 or rng.random() > 0.12])
    (warning,) = condition.warnings(_servos(), NONE, NONE)
    assert "bad cable" in warning
    assert "leg 3 femur" in warning


def _joints(*chosen: int) -> np.ndarray:
    return np.isin(np.arange(18), chosen)


def test_a_warning_stays_while_little_changes_and_goes_when_it_is_over() -> None:
    condition, shares, _ = _condition()
    rng, said = random.Random(0), set()
    for _ in range(2000):
        shares.take([7], [7] if rng.random() > 0.3 else [])
        said.add(tuple(condition.warnings(_servos(), NONE, NONE)))
    assert len(said) == 2, "none, and the warning"
    for _ in range(1000):
        shares.take([7], [7])
    assert condition.warnings(_servos(), NONE, NONE) == []


def test_neither_one_garbled_answer_in_a_hundred_nor_a_silent_servo_is_a_bad_cable() -> None:
    condition, shares, _ = _condition()
    rng = random.Random(1)
    for _ in range(2000):
        shares.take(range(18), [joint for joint in range(18) if rng.random() > 0.01])
        assert condition.warnings(_servos(), NONE, NONE) == []
    for _ in range(500):
        shares.take(range(18), [joint for joint in range(18) if joint != 7])
    assert condition.warnings(_servos(), NONE, _joints(7)) == []
    shares.take(range(18), range(18))
    assert condition.warnings(_servos(), NONE, NONE) == []


def test_a_sag_of_several_servos_is_a_brown_out_and_that_of_one_is_not() -> None:
    condition, shares, clock = _condition("xl430-w250")
    for _ in range(100):
        shares.take(range(18), [])
        shares.take(range(18), range(18))  # half of the answers
    assert "bad cable" in condition.warnings(_servos(), NONE, NONE)[0]
    some = _servos()
    for joint, sags in ((3, False), (8, False), (15, True)):  # one, two and three servos
        some.voltages_v[joint] = 9.2
        assert ("brown-out" in condition.warnings(some, NONE, NONE)[0]) == sags
    clock.now_s = 12.0
    assert "brown-out" not in condition.warnings(_servos(), NONE, NONE)[0]
    (warning,) = condition.warnings(_servos(9.2), NONE, NONE)
    assert re.match("brown-out: .* fell from 12 V to 9 V", warning)
    clock.now_s = 14.0
    (warning,) = condition.warnings(_servos(), _joints(0, 1, 2, 3), _joints(8))
    assert re.search(r"restarted without torque; .*leg 3 tibia \(id 9\)", warning)
    clock.now_s = 25.0
    assert not any("brown-out" in each for each in condition.warnings(_servos(), NONE, NONE))


def test_a_battery_that_drains_is_no_brown_out() -> None:
    condition, _, clock = _condition("xl430-w250")
    for second in range(0, 4000, 5):  # to 6 V: the servos need 6.5
        clock.now_s = second
        assert condition.warnings(_servos(12.6 - 0.1 * (second // 60)), NONE, NONE) == []


def test_servos_that_say_why_they_let_go_have_not_restarted() -> None:
    condition, _, _ = _condition()
    tripped = replace(_servos(), errors=("overload",) * 18)
    assert condition.warnings(tripped, _joints(0, 1, 2, 3), NONE) == []
    assert "restarted" in condition.warnings(_servos(), _joints(0, 1, 2, 3), NONE)[0]


@pytest.mark.parametrize(
    ("driver", "model", "fault", "told"),
    [
        ("feetech", "sts3215", "brown-out@1", lambda said: "brown-out" in said and "restarted" in said),
        ("lx16a", "lx16a", "brown-out@1", lambda said: "brown-out" in said and "restarted" in said),
        ("dynamixel", "ax12a", "bad-cable:3:femur:0.3", lambda said: "answers of leg 3 femur" in said),
        ("feetech", "sts3215", "garble:0.4", lambda said: "servos are damaged" in said),
    ],
)
def test_on_a_bus_each_is_told(driver: str, model: str, fault: str, told: Callable[[str], bool]) -> None:
    bus_map = a_map(driver, model)
    with memory_bus(bus_map, fault) as bus, servos_on(bus, bus_map) as servos:
        state = until(servos, lambda state: told("\n".join(state.warnings)), ticks=1000)
        said = "\n".join(state.warnings)
        assert ("bad cable" in said) != ("brown-out" in said)
        assert said.count("bad cable") <= 1
        assert set(servos.link_counts) >= {"missed", "garbled"}


# Servos in abnormal states, at connect and in their reports, for every family.

#: The servo that is not as the others: leg 3 femur, id 8.
ODD = 7

Change = Callable[[Any], None]


@dataclass(frozen=True)
class State:
    """A change of the odd servo or faults of the bus, and what must be said of it."""

    name: str
    says: str
    change: Change = lambda _: None
    faults: tuple[str, ...] = ()
    other_baud: bool = False
    p_gain: int | None = None


def stored(address: int, value: int, size: int = 1) -> Change:
    """A setting that is kept without power."""

    def change(servo: BusServo) -> None:
        servo.set(Register(address, size), value)
        servo._keep()

    return change


def now(address: int, value: int, size: int = 1) -> Change:
    """A setting until the next restart."""

    def change(servo: BusServo) -> None:
        servo.set(Register(address, size), value)

    return change


def both(*changes: Change) -> Change:
    def change(servo: Any) -> None:
        for each in changes:
            each(servo)

    return change


def keeps(address: int) -> Change:
    """A setting that cannot be written."""

    def change(servo: BusServo) -> None:
        write = servo.write
        vars(servo)["write"] = lambda at, data: 0 if at == address else write(at, data)

    return change


def made(**values: object) -> Change:
    def change(servo: SimulatedLx16aServo) -> None:
        for name, value in values.items():
            setattr(servo, name, value)

    return change


def tripped(servo: Any) -> None:
    servo.trip()


X = [
    State("velocity mode", "set its operating mode from 1 to 3", stored(11, 1)),
    State("velocity mode, torque on", "its operating mode is 1, not 3", both(stored(11, 1), now(64, 1))),
    State(
        "time-based profile", "set its flag for moves by time (time-based profile) from 1 to 0", stored(10, 4)
    ),
    State(
        "time-based profile, 2000 ms, torque on",
        "its flag for moves by time (time-based profile) is 1, not 0",
        both(stored(10, 4), now(112, 2000, 4), now(64, 1)),
    ),
    State(
        "time-based profile, 2000 ms",
        "set its profile register 112 from 2000 ms to 0",
        both(stored(10, 4), now(112, 2000, 4), now(108, 300, 4)),
    ),
    State("counts in reverse", "its flag for counts in reverse is 1", stored(10, 1)),
    State("torque on by a goal", "goals that switch its torque on is 1, not 0", stored(10, 8)),
    State("secondary id", "it also follows the goals of id 5", stored(12, 5)),
    State("answers pings only", "set its status return level to 2", now(68, 0)),
    State("alert after an overload", "it switched its torque off (overload)", tripped),
    State("low voltage alert", "its alert is on (voltage), and its torque stays on", now(70, 1)),
    State("a fifth of the torque", "its stored maximum torque is 20 %", stored(36, 177, 2)),
    State("wrong baud rate", "no servo answers on ", other_baud=True),
    State("another supply", "is made for lower voltages (firmware 45, 4 to 8 V)", stored(32, 80, 2)),
    State("unknown firmware", "lower voltages (4 to 8 V)", both(stored(32, 80, 2), stored(6, 0))),
    State("old firmware", "its firmware 37 is older than 38, and lacks a watchdog", stored(6, 37)),
    State("half torque", "its torque is limited to 50 %", now(100, 443, 2)),
    State("speed limit", "its speed is limited to 55 degrees/s", now(112, 40, 4)),
    State("acceleration limit", "its acceleration is limited to 215 degrees/s^2", now(108, 10, 4)),
    State("another P gain", "its P gain is 400, from the factory 640", now(84, 400, 2)),
    State("P gain of the file", "set its P gain from 400 to 640, as", now(84, 400, 2), p_gain=640),
    State(
        "P gain of the file, torque on",
        "its P gain is 400, and the robot file states 640",
        both(now(84, 400, 2), now(64, 1)),
        p_gain=640,
    ),
    State("D gain", "its D gain is 40, from the factory 4000", now(80, 40, 2)),
    State("homing offset", "it adds a stored offset", stored(20, -300 % 2**32, 4)),
    State("no protection from heat", "it does not protect itself from heat", stored(63, 0b100000)),
]

AX = [
    State("wheel mode", "it is in wheel mode", both(stored(6, 0, 2), stored(8, 0, 2))),
    State("torque limit 0 after an overload", "overload: ", tripped),
    State("half power", "voltage: all servos", faults=("battery:6",)),
    State("soft slope", "its CW compliance slope is 128, from the factory 32", now(28, 128)),
    State("P gain of the file", "it has no P gain", p_gain=32),
]

STS = [
    State("velocity mode", "set its operating mode from 1 to 0", stored(33, 1)),
    State("velocity mode, torque on", "its operating mode is 1, not 0", both(stored(33, 1), now(40, 1))),
    State("more than one turn", "set its flag for positions beyond one turn from 1 to 0", stored(18, 28)),
    State("speed 0 is a stop", "set its flag for a speed of 0 as full speed from 0 to 1", stored(18, 4)),
    State("speed in 0.732 rpm", "its speed is limited to 44 degrees/s", both(stored(18, 8), now(46, 10, 2))),
    State("acceleration limit", "its acceleration is limited to 439 degrees/s^2", now(41, 50)),
    State("P gain of LeRobot", "set its P gain from 16 to 32, as", stored(21, 16), p_gain=32),
    State("P gain that it keeps", "(it keeps 16)", both(stored(21, 16), keeps(21)), p_gain=32),
    State("angular resolution that it keeps", "vendor's tool", both(stored(30, 3), keeps(30))),
    State("dead zone", "its CCW dead zone is 8, from the factory 1", stored(27, 8)),
    State("offset", "it adds a stored offset", stored(31, 2148, 2)),
    State("angular resolution 3", "set its angular resolution from 3 to 1", stored(30, 3)),
    State(
        "angular resolution, torque on", "its angular resolution is 3, not 1", both(stored(30, 3), now(40, 1))
    ),
    State("overload", "overload: ", tripped),
    State("hot", "hot, 72 degrees C", faults=("hot:3:femur:72",)),
    State("id used twice", "several servos with the same id answer together", faults=("same-id:3:femur",)),
    State(
        "half power",
        "its supply is low, 3.8 V (firmware 3.10, 12 V type",
        faults=("battery:3.8",),
    ),
    State(
        "7.4 V type on 12 V",
        "it has 12 V and is made for lower voltages (firmware 3.10, 7.4 V type, 4 to 8 V)",
        stored(14, 80),
    ),
    State("old firmware", "its firmware 3.9 is older than 3.10, and lacks readings of all", stored(1, 9)),
    State(
        "another firmware than the others",
        "firmware differs, 3.10 on most servos: 3.11: leg 3 femur",
        stored(1, 11),
    ),
]

LX = [
    State("motor mode", "ended its motor mode", made(motor=True)),
    State("limits end early", "its stored limits 400 to 600 end within", made(limits=(400, 600))),
    State("offset", "it adds a stored offset", made(offset=60)),
    State("heat limit off", "it lets go at 100 degrees C, from the factory at 85", made(most_c=100)),
    State(
        "another supply", "it has 7.4 V, and lets go outside 9.0 to 12.0 V", made(voltages_mv=(9000, 12000))
    ),
    State("warm", "warm, 66 degrees C", faults=("hot:3:femur:66",)),
    State("half power", "it has 3.7 V, and lets go outside", faults=("battery:3.7",)),
    State("does not answer", "mute: ", faults=("mute:3:femur",)),
]

FAMILIES = {
    ("dynamixel", "xl430-w250"): X,
    ("dynamixel", "ax12a"): AX,
    ("feetech", "sts3215"): STS,
    ("lx16a", "lx16a"): LX,
}


def said(driver: str, model: str, state: State, *, later_ticks: int = 0) -> str:
    """What is said when the robot is connected, or of its servos' reports after that."""
    bus_map = replace(a_map(driver, model), p_gain=state.p_gain)
    with memory_bus(bus_map, *state.faults, baud=57_600 if state.other_baud else None) as bus:
        state.change(bus.board._servos[ODD])
        try:
            with servos_on(bus, bus_map) as servos:
                until(servos, lambda seen: state.says in "; ".join(seen.warnings), write=False)
                for _ in range(later_ticks):
                    servos.clock.tick()
                return "; ".join(servos.read().warnings)
        except RobotFaultError as error:
            return f"refused: {error}"


@pytest.mark.parametrize(
    ("family", "state"),
    [(family, state) for family, states in FAMILIES.items() for state in states],
    ids=lambda each: each.name if isinstance(each, State) else each[1],
)
def test_an_abnormal_state_is_named(family: tuple[str, str], state: State) -> None:
    words = said(*family, state)
    assert state.says in words
    assert not ("it keeps" in words and "power" in words), "it has no torque, and would keep it again"


def test_durations_are_not_reported_as_speeds() -> None:
    state = next(each for each in X if each.name == "time-based profile, 2000 ms")
    words = said("dynamixel", "xl430-w250", state, later_ticks=50)
    assert "degrees/s" not in words
    assert "set its profile register 108 from 300 ms to 0" in words


def test_noise_between_answers_is_named_at_connect(monkeypatch: pytest.MonkeyPatch) -> None:
    line = BoardLine(a_map(), "noise:1")
    monkeypatch.setattr("hexctl.backends.bus.servos.SerialLine", lambda *_, **__: line)
    robot = BusServos(shipped("phantomx"), bus_map=a_map(), port="memory", clock=WallClock(time=line.time))
    robot._open(first=True)
    assert "noise, a missing ground" in robot._notes[0]
