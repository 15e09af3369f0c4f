"""Readings that are believed, and such that are not."""

import numpy as np

from hexctl.backends.bus.readings import BelievedReadings
from hexctl.backends.bus.servo_bus import Report, ServoBus


def _report(at_s: float, position: float, *, joint: int = 4, temperature_c: float = 40.0) -> Report:
    return Report(
        place=joint,
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


def test_wild_positions_that_differ_are_never_believed() -> None:
    readings = _readings(100)
    for tick in range(1, 50):
        readings.take([_report(0.02 * tick, 1000.0 * (1 + tick % 4))])
        assert readings.positions[4] == 100


def test_a_position_that_is_never_believed_again_becomes_stale_while_its_servo_is_heard() -> None:
    """Its last believed position was taken for one of now."""
    readings = _readings(250)
    for tick in range(round(ServoBus.stale_s / 0.02) + 1):
        at_s = 0.02 * tick
        readings.take([_report(at_s, 500.0 * (tick % 2))])
    assert readings.positions[4] == 250
    assert readings.heard_at_s[4] == at_s
    assert readings.servos(at_s).ages_s[4] > ServoBus.stale_s


def test_one_wild_position_makes_no_joint_stale() -> None:
    readings = _readings(2000)
    for tick, position in enumerate((2000, 4000, 2000, 2000, 4000, 2000)):
        readings.take([_report(0.02 * tick, position)])
        assert readings.servos(0.02 * tick).ages_s[4] < ServoBus.stale_s / 4


def test_a_joint_that_was_not_heard_for_long_may_be_anywhere() -> None:
    readings = _readings(100)
    readings.take([_report(1.0, 2000)])
    assert readings.positions[4] == 2000


def test_one_temperature_that_is_wrong_makes_no_servo_hot() -> None:
    readings = _readings(100)
    for tick, degrees in enumerate((40, 77, 41, 70, 40)):
        readings.take([_report(0.02 * tick, 100, temperature_c=degrees)])
        assert readings.servos(0.1).temperatures_c[4] <= 41
    for tick in range(3):
        readings.take([_report(0.2 + 0.02 * tick, 100, temperature_c=72)])
    assert readings.servos(0.3).temperatures_c[4] == 72


def test_a_first_temperature_that_is_wrong_makes_no_servo_hot() -> None:
    readings = _new()
    for tick, degrees in enumerate((126, 40, 41)):
        readings.take([_report(0.02 * tick, 100, temperature_c=degrees)])
        assert not readings.servos(0.1).temperatures_c[4] > 41
    assert readings.servos(0.1).temperatures_c[4] == 41


def test_every_joint_has_an_age_of_its_own() -> None:
    readings = _new()
    for at_s in (-0.5, 0.0):  # the first is not believed
        readings.take([_report(1.0 + at_s, 100, joint=0), _report(1.5 + at_s, 100, joint=7)])
    ages = readings.servos(2.0).ages_s
    assert (ages[0], ages[7]) == (1.0, 0.5)
    assert np.isinf(ages[1])
