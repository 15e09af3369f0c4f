"""Readings that are believed, and what they say of the line: a brown-out is no bad cable."""

import random
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.bus.line_condition import AnswerShares, LineCondition
from hexctl.backends.bus.readings import BelievedReadings
from hexctl.backends.bus.servo_bus import Report, ServoBus
from hexctl.types import JointTargets, ServoReadings
from tests.backends.bus.boards import a_map, memory_bus, servos_on
from tests.backends.fake_time import FakeTime


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


def _joints(*chosen: int) -> np.ndarray:
    return np.isin(np.arange(18), chosen)


def test_the_share_of_damaged_answers_is_told() -> None:
    condition, shares, _ = _condition()
    rng = random.Random(3)
    for _ in range(400):
        shares.take(range(18), [joint for joint in range(18) if joint != 7 or rng.random() > 0.12])
    (warning,) = condition.warnings(_servos(), NONE, NONE)
    assert re.match("bad cable.* leg 3 femur", warning)


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
    one = _servos()
    one.voltages_v[3] = 7.0
    assert not any("brown-out" in each for each in condition.warnings(one, NONE, NONE))
    clock.now_s = 1.0
    (warning,) = condition.warnings(_servos(9.2), NONE, NONE)
    assert re.match("brown-out: .* fell from 12 V to 9 V", warning)
    clock.now_s = 3.0
    (warning,) = condition.warnings(_servos(), _joints(0, 1, 2, 3), _joints(8))
    assert re.search(r"restarted without torque; .*leg 3 tibia \(id 9\)", warning)
    clock.now_s = 14.0
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
        for _ in range(1000):
            servos.clock.tick()
            said = "\n".join(servos.read().warnings)
            if told(said):
                break
            servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
        assert told(said)
        assert ("bad cable" in said) != ("brown-out" in said)
        assert said.count("bad cable") <= 1
        assert set(servos.link_counts) >= {"missed", "garbled"}
