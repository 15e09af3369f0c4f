"""Heat and a low battery are believed from telemetry with spikes, repeated values and gaps."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.telemetry_watch import (
    ALL_SERVOS,
    LEAST_PACE,
    MOST_CORRECTION_M,
    MOST_M,
    MOST_SPEED_M_S,
    TOLD_S,
    BatteryWatch,
    PositionCheck,
    SeenWarnings,
    Temperatures,
    hot_servos,
    pace,
    with_troubles,
)
from hexctl.types import N_JOINTS, FloatArray, joint_in_words
from tests.control.posed import connected, read_for

DT_S = 0.02


def believed(readings: list[float]) -> list[float]:
    watch = Temperatures()
    return [float(watch.take(np.array([each]), DT_S * n)[0]) for n, each in enumerate(readings)]


@pytest.mark.parametrize(
    ("spike", "ticks"),
    [(142.0, 1), (142.0, 45), (0.0, 20), (255.0, 90)],  # up to 1.8 s, as a servo's own sensor glitches
)
def test_a_spike_is_not_believed(spike: float, ticks: int) -> None:
    found = believed([31.0] * 50 + [spike] * ticks + [31.0] * 50)
    assert set(found) == {31.0}


def test_spikes_of_several_heights_are_none_either() -> None:
    found = believed([31.0] * 9 + [142.0, 90.0, 31.0, 142.0, 142.0, 12.0, 31.5] * 30)
    assert max(found) == 31.5


@pytest.mark.parametrize("rate_c_s", [0.2, 1.0, 1.9])
def test_a_servo_that_warms_is_followed(rate_c_s: float) -> None:
    rises = [40.0 + rate_c_s * DT_S * n for n in range(2000)]
    assert believed(rises) == rises
    whole = [float(round(each)) for each in rises]  # servos report whole degrees
    assert believed(whole) == whole


def test_a_jump_that_lasts_is_believed_after_two_seconds() -> None:
    found = believed([35.0] * 10 + [72.0] * 120)
    assert found[100] == 35.0
    assert found[-1] == 72.0


def test_gaps_and_repeated_values_change_nothing() -> None:
    rng = np.random.default_rng(7)
    rises = np.repeat(np.linspace(40, 66, 600), 1 + (rng.random(600) < 0.12))
    rises[rng.random(len(rises)) < 0.1] = np.nan
    found = np.array(believed(rises.tolist()))
    assert np.nanmax(found) == pytest.approx(66, abs=0.2)
    assert (np.diff(found[np.isfinite(found)]) >= 0).all()


@pytest.mark.parametrize(
    ("degrees", "share"),
    [([np.nan, np.nan], 1.0), ([60.0, np.nan], 1.0), ([64.0, 40.0], 0.7), ([90.0], LEAST_PACE)],
)
def test_the_pace_falls_with_the_hottest_servo(degrees: list[float], share: float) -> None:
    assert pace(np.array(degrees)) == pytest.approx(share)


def lows(volts: Sequence[float]) -> list[bool]:
    watch = BatteryWatch()
    return [watch.low(each, 9.0, DT_S * n) for n, each in enumerate(volts)]


def test_a_battery_that_is_low_for_two_seconds_is_low() -> None:
    found = lows([11.0] * 200 + [8.7] * 120)
    assert not any(found[:230])
    assert found[-1]
    assert lows([8.0] * 120)[-1], "low from the start"


@pytest.mark.parametrize("dip", [0.0, 3.1, 8.9])
@pytest.mark.parametrize("every", [3, 10])
def test_dips_of_steps_and_spikes_are_not_low(dip: float, every: int) -> None:
    assert not any(lows([dip if n % every == 0 else 9.4 for n in range(500)]))


def test_after_a_gap_earlier_readings_do_not_count() -> None:
    watch = BatteryWatch()
    for n in range(90):
        watch.low(8.0, 9.0, DT_S * n)
    assert not watch.low(8.0, 9.0, 30.0)


def test_a_clock_that_begins_anew_forgets_what_was_before() -> None:
    watch = BatteryWatch()
    for n in range(200):
        watch.low(8.0, 9.0, 100 + DT_S * n)
    assert not any(watch.low(11.0, 9.0, DT_S * n) for n in range(200))


def at(x_m: float) -> FloatArray:
    return np.array([x_m, 0.0, 0.1])


@pytest.mark.parametrize("x_m", [3e38, -3e38, 1e300, math.inf, math.nan, MOST_CORRECTION_M + 0.2, -3.0])
def test_a_jump_is_not_believed(x_m: float) -> None:
    check = PositionCheck()
    assert check.believes(at(0.0), 0.0)
    assert not check.believes(at(x_m), DT_S)
    assert check.believes(at(0.001), 2 * DT_S)
    assert check.doubted == 1
    check.forget()  # the next is taken as it is, but no robot is beyond the earth
    assert check.believes(at(100.0), DT_S)
    for nowhere_m in (3e38, math.inf, math.nan, 2.1 * MOST_M):
        assert not PositionCheck().believes(at(nowhere_m), 0.0)
    assert PositionCheck().believes(at(0.5 * MOST_M), 0.0)


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=50))
def test_a_robot_that_moves_as_it_can_is_believed(speeds: list[float]) -> None:
    check, x_m = PositionCheck(), 0.0
    for tick, speed in enumerate(speeds):
        x_m += speed * MOST_SPEED_M_S * DT_S
        assert check.believes(at(x_m), tick * DT_S)
    assert check.doubted == 0


def test_a_place_that_stays_is_believed_once_it_can_be_reached() -> None:
    check = PositionCheck()
    check.believes(at(0.0), 0.0)
    believed = [check.believes(at(3.0), tick * DT_S) for tick in range(1, 51)]
    first_s = (believed.index(True) + 1) * DT_S
    assert first_s == pytest.approx((3.0 - MOST_CORRECTION_M) / MOST_SPEED_M_S, abs=DT_S)
    assert all(believed[believed.index(True) :])
    assert check.doubted == 1  # the same position, again and again


def test_it_tells_of_the_first_jump_of_several_and_for_a_while() -> None:
    check = PositionCheck()
    check.believes(at(0.0), 0.0)
    assert check.doubt(0.0) is None
    for tick in range(3):
        check.believes(at(3e38 / (tick + 1)), tick * DT_S)
    assert "3e+38 m" in (check.doubt(3 * DT_S) or "")
    assert check.doubt(3 * DT_S + TOLD_S) is None
    assert check.doubted == 3


def test_behind_the_guard_a_jump_is_no_position_and_does_not_stop() -> None:
    guard, servos = connected()
    read_for(guard, 0.1)
    servos.position_world = at(3e38)
    read_for(guard, 0.1)
    state = guard.read()
    assert state.base_position_world is None
    assert state.base_quaternion_world is not None
    assert guard.peek().base_position_world is None
    servos.position_world = at(0.01)
    read_for(guard, 0.1)
    assert guard.read().base_position_world is not None
    assert guard.stopped is None
    assert guard.positions.doubted == 1
    servos.position_world = at(3e38)
    read_for(guard, 6.0)
    assert guard.stopped == "pose lost"


def test_a_warning_is_new_once_whatever_its_figure_and_those_of_failed_legs_explain_a_stop() -> None:
    seen = SeenWarnings()
    assert seen.take(()) == []
    assert seen.take(("warm, 61 degrees C: leg 2 femur (id 5)", "mute: leg 5 coxa (id 13)")) != []
    assert seen.take(("warm, 62 degrees C: leg 2 femur (id 5)",)) == []
    assert seen.take(("hot, 70 degrees C: leg 2 femur (id 5)",)) == ["hot, 70 degrees C: leg 2 femur (id 5)"]
    warm, mute, hot = seen.texts
    assert "62" in warm
    assert with_troubles("leg 5 limp", seen.texts, [5]) == f"leg 5 limp; {mute}"
    assert with_troubles("leg 2 limp", seen.texts, [2]) == f"leg 2 limp; {hot}", "a warm servo works"
    assert with_troubles("leg 1 limp", seen.texts, [1]) == "leg 1 limp"


def test_servos_that_warm_up_one_by_one_are_one_warning_and_each_is_new_once() -> None:
    names = [f"{joint_in_words(joint)} (id {joint + 1})" for joint in range(N_JOINTS)]
    seen = SeenWarnings((f"warm, 60 degrees C: {names[0]}",))
    for count in range(1, N_JOINTS):
        text = f"warm, {60 + count} degrees C: {', '.join(names[: count + 1])}"
        assert seen.take((text,)) == [f"warm, {60 + count} degrees C: {names[count]}"]
        assert seen.take((f"warm, 70 degrees C: {names[0]}",)) == [], "cooler ones are not warm again"
        assert seen.news == seen.texts == (text.replace(str(60 + count), "70"),)
    assert seen.take((f"warm, 71 degrees C: {ALL_SERVOS}",)) == [f"warm, 71 degrees C: {ALL_SERVOS}"]
    assert seen.take((f"warm, 70 degrees C: {names[3]}",)) == []
    assert seen.texts == (f"warm, 70 degrees C: {ALL_SERVOS}",)
    assert SeenWarnings(seen.texts).news == ()


@pytest.mark.parametrize(
    ("text", "servos"),
    [
        ("hot, 72 degrees C: leg 5 femur (id 15)", "leg 5 femur (id 15)"),
        ("hot: leg 5 femur 72 C", "leg 5 femur"),
        ("leg 5 limp; voltage, hot: leg 5 femur (id 15); mute: leg 5 tibia (id 16)", "leg 5 femur (id 15)"),
        ("hardware alert (hot), limp: all servos", "all servos"),
        ("warm, 62 degrees C: leg 5 femur (id 15)", ""),
    ],
)
def test_hot_servos_are_found_in_any_text_that_names_them(text: str, servos: str) -> None:
    assert hot_servos("mute: leg 1 coxa (id 1)", text) == servos
