"""A brown-out is told from a bad cable, and neither is seen where there is none."""

import random
import re
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.bus.line_condition import AnswerShares, LineCondition
from hexctl.backends.bus.servos import BusServos
from hexctl.types import JointTargets, ServoReadings
from tests.backends.bus.boards import a_map, bus_board, servos_on
from tests.backends.fake_time import FakeTime

NONE = np.zeros(18, dtype=bool)


def _readings(volts: float = 12.0) -> ServoReadings:
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
    (warning,) = condition.warnings(_readings(), NONE, NONE)
    found = re.fullmatch(
        r"bad cable or noise: (\d+) % of the answers of leg 3 femur \(id 8\) are damaged or missing", warning
    )
    assert found
    assert 6 <= int(found[1]) <= 20
    assert condition.warnings(_readings(), NONE, NONE) == [warning]


def test_words_stay_while_little_changes_and_go_when_it_is_over() -> None:
    condition, shares, _ = _condition()
    rng, said = random.Random(0), set()
    for _ in range(2000):
        shares.take([7], [7] if rng.random() > 0.3 else [])
        said.add(tuple(condition.warnings(_readings(), NONE, NONE)))
    assert len(said) <= 6, "one for each tick would fill the events"
    for _ in range(1000):
        shares.take([7], [7])
    assert condition.warnings(_readings(), NONE, NONE) == []


def test_one_garbled_answer_in_a_hundred_is_not_worth_a_word() -> None:
    condition, shares, _ = _condition()
    rng = random.Random(1)
    for _ in range(5000):
        shares.take(range(18), [joint for joint in range(18) if rng.random() > 0.01])
        assert condition.warnings(_readings(), NONE, NONE) == []


def test_a_silent_servo_has_no_bad_answers() -> None:
    condition, shares, _ = _condition()
    for _ in range(200):
        shares.take(range(18), range(18))
    for _ in range(500):
        shares.take(range(18), [joint for joint in range(18) if joint != 7])
    assert condition.warnings(_readings(), NONE, _joints(7)) == []
    shares.take(range(18), range(18))
    assert condition.warnings(_readings(), NONE, NONE) == []


def test_a_sag_of_several_servos_is_a_brown_out_and_that_of_one_is_not() -> None:
    condition, shares, clock = _condition("xl430-w250")
    for _ in range(100):
        shares.take(range(18), [])
        shares.take(range(18), range(18))  # half of the answers
    assert "bad cable" in condition.warnings(_readings(), NONE, NONE)[0]
    one = _readings()
    one.voltages_v[3] = 7.0
    assert not any("brown-out" in each for each in condition.warnings(one, NONE, NONE))
    clock.now_s = 1.0
    (warning,) = condition.warnings(_readings(9.2), NONE, NONE)
    assert warning.startswith("brown-out: several servos have 9 V, where they had 12 V; is the supply")
    clock.now_s = 3.0
    (warning,) = condition.warnings(_readings(), _joints(0, 1, 2, 3), _joints(8))
    assert "several have restarted without torque; some have lost their ids (leg 3 tibia (id 9))" in warning
    clock.now_s = 14.0
    assert not any("brown-out" in each for each in condition.warnings(_readings(), NONE, NONE))


def test_servos_below_what_their_model_needs_are_told_at_connect() -> None:
    condition, _, _ = _condition("ax12a")
    assert condition.warnings(_readings(8.4), NONE, NONE)[0].startswith(
        "brown-out: several servos have 8 V; "
    )


def test_a_battery_that_drains_is_no_brown_out() -> None:
    condition, _, clock = _condition("xl430-w250")
    for minute in range(40):
        for second in range(0, 60, 5):
            clock.now_s = 60 * minute + second
            assert condition.warnings(_readings(12.6 - 0.1 * minute), NONE, NONE) == []


def test_servos_that_say_why_they_let_go_have_not_restarted() -> None:
    condition, _, _ = _condition()
    tripped = replace(_readings(), errors=("overload",) * 18)
    assert condition.warnings(tripped, _joints(0, 1, 2, 3), NONE) == []
    assert condition.warnings(_readings(), _joints(0, 1, 2, 3), NONE)[0].startswith(
        "brown-out: several have restarted without torque; is the supply"
    )


def _until(servos: BusServos, holds: Callable[[str], bool]) -> str:
    """Warnings of the first tick in which a condition holds, while the stance is commanded."""
    deadline_s, said = time.monotonic() + 20.0, ""
    while time.monotonic() < deadline_s:
        servos.clock.tick()
        said = "\n".join(servos.read().warnings)
        if holds(said):
            return said
        servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
    raise AssertionError(said)


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.parametrize(
    ("driver", "model"),
    [("feetech", "sts3215"), ("dynamixel", "ax12a"), ("dynamixel", "xl430-w250"), ("lx16a", "lx16a")],
)
def test_on_a_bus_a_brown_out_is_told(driver: str, model: str) -> None:
    bus_map = a_map(driver, model)
    with bus_board(bus_map, "brown-out@4") as board, servos_on(board, bus_map) as servos:
        said = _until(servos, lambda said: "brown-out" in said and "restarted without torque" in said)
    assert "bad cable" not in said


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.parametrize(("driver", "model"), [("feetech", "sts3215"), ("dynamixel", "ax12a")])
def test_on_a_bus_a_bad_cable_is_told(driver: str, model: str) -> None:
    bus_map = a_map(driver, model)
    with bus_board(bus_map, "bad-cable:3:femur:0.3") as board, servos_on(board, bus_map) as servos:
        said = _until(servos, lambda said: "bad cable" in said)
        assert "of the answers of leg 3 femur (id 8) are damaged or missing" in said
        assert said.count("bad cable") == 1
        assert "brown-out" not in said
        assert set(servos.link_counts) >= {"missed", "garbled"}
        assert all(isinstance(count, int) for count in servos.link_counts.values())


@pytest.mark.long
@pytest.mark.realtime
def test_on_a_bus_noise_on_all_lines_is_told_once() -> None:
    with bus_board(a_map(), "garble:0.4") as board, servos_on(board, a_map()) as servos:
        _until(servos, lambda said: re.search(r"bad cable or noise: \d+ % of all answers", said) is not None)
