"""Heat, a low battery and jumps of the position: what is believed of them, and a robot that sits down."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.mock import MockServos
from hexctl.control.controllers import sitting_angles_rad
from hexctl.control.drive.arbiter import Arbiter
from hexctl.control.drive.drive import Drive
from hexctl.control.guard import Guard
from hexctl.control.sit_down import sit_down
from hexctl.control.telemetry_watch import (
    ALL_SERVOS,
    LEAST_PACE,
    MOST_CORRECTION_M,
    MOST_M,
    MOST_SPEED_M_S,
    REPEAT_S,
    BatteryWatch,
    PositionCheck,
    SeenWarnings,
    Temperatures,
    hot_servos,
    pace,
    with_troubles,
)
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import EStopError
from hexctl.gait.gait import make_gait
from hexctl.types import N_JOINTS, FloatArray, JointTargets, RobotState, joint_in_words
from tests.backends.fake_time import FakeTime
from tests.control.posed import connected, read_for, readings
from tests.robots import shipped

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
    assert check.accepts(at(0.0), 0.0)
    assert not check.accepts(at(x_m), DT_S)
    assert check.accepts(at(0.001), 2 * DT_S)
    assert check.doubted == 1
    check.forget()  # the next is taken as it is, but no robot is beyond the earth
    assert check.accepts(at(100.0), DT_S)
    for nowhere_m in (3e38, math.inf, math.nan, 2.1 * MOST_M):
        assert not PositionCheck().accepts(at(nowhere_m), 0.0)
    assert PositionCheck().accepts(at(0.5 * MOST_M), 0.0)


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=50))
def test_a_robot_that_moves_as_it_can_is_believed(speeds: list[float]) -> None:
    check, x_m = PositionCheck(), 0.0
    for tick, speed in enumerate(speeds):
        x_m += speed * MOST_SPEED_M_S * DT_S
        assert check.accepts(at(x_m), tick * DT_S)
    assert check.doubted == 0


def test_a_place_that_stays_is_believed_once_it_can_be_reached() -> None:
    check = PositionCheck()
    check.accepts(at(0.0), 0.0)
    believed = [check.accepts(at(3.0), tick * DT_S) for tick in range(1, 51)]
    first_s = (believed.index(True) + 1) * DT_S
    assert first_s == pytest.approx((3.0 - MOST_CORRECTION_M) / MOST_SPEED_M_S, abs=DT_S)
    assert all(believed[believed.index(True) :])
    assert check.doubted == 1  # the same position, again and again


def test_it_tells_of_the_first_jump_of_several_and_for_a_while() -> None:
    check = PositionCheck()
    check.accepts(at(0.0), 0.0)
    assert check.doubt(0.0) is None
    for tick in range(3):
        check.accepts(at(3e38 / (tick + 1)), tick * DT_S)
    assert "3e+38 m" in (check.doubt(3 * DT_S) or "")
    assert check.doubt(3 * DT_S + REPEAT_S) is None
    assert check.doubted == 3


def test_behind_the_guard_a_jump_is_no_position_and_does_not_stop() -> None:
    guard, servos = connected()
    servos.frozen = True
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


# A guard that stops for a low battery or heat lets the robot sit down


class Reporting(MockServos):
    """Servos whose telemetry a test writes: voltage and one temperature by time."""

    def __init__(
        self,
        volts: Callable[[float], float] = lambda _: 11.0,
        degrees: Callable[[float], float] = lambda _: 40.0,
        least_v: float | None = 9.0,
    ) -> None:
        super().__init__(shipped("phantomx"), clock=FakeTime().clock())
        self._volts, self._degrees, self._least_v, self.limp = volts, degrees, least_v, False

    def read(self) -> RobotState:
        now_s = self.clock.now_s
        warm = np.full(18, 40.0)
        warm[4] = self._degrees(now_s)
        servos = readings(currents_a=np.full(18, 124.8), temperatures_c=warm)
        return replace(
            super().read(), battery_v=self._volts(now_s), low_battery_v=self._least_v, servos=servos
        )

    def disable_torque(self) -> bool:
        self.limp, self.ended_rad = True, super().read().joint_positions_rad
        return super().disable_torque()


def walked(servos: Reporting, seconds: float = 6.0) -> str | None:
    """Why a trial was stopped; the robot may sit down afterwards."""
    plan = TrialPlan(gait=make_gait(servos.robot, "tripod"), duration_s=seconds)
    with Guard(servos) as guard:
        return run_trial(guard, plan).stopped


@pytest.mark.parametrize(
    ("servos", "reason"),
    [
        (Reporting(volts=lambda at_s: 11.0 if at_s < 2 else 8.6), "low battery: 8.6 V"),
        (Reporting(volts=lambda at_s: 9.5 - 0.3 * at_s), "low battery: "),
        (Reporting(degrees=lambda at_s: 62 + at_s), "hot: leg 2 femur 68 C"),
        (Reporting(degrees=lambda at_s: 40 if at_s < 1 else 80), "hot: leg 2 femur 80 C"),
    ],
)
def test_the_robot_sits_down_and_goes_limp(servos: Reporting, reason: str) -> None:
    stopped = walked(servos, 8.0)
    assert stopped is not None
    assert stopped.startswith(reason)
    assert servos.limp
    assert np.allclose(servos.ended_rad, sitting_angles_rad(servos.robot), atol=0.02)


@pytest.mark.parametrize(
    "servos",
    [
        Reporting(degrees=lambda at_s: 142.0 if 2 < at_s < 3 else 31.0),
        Reporting(volts=lambda at_s: 0.0 if 2 < at_s < 2.8 else 11.0),
        Reporting(volts=lambda _: 3.0, least_v=None),
        Reporting(degrees=lambda at_s: float("nan") if int(50 * at_s) % 3 else 40.0),
    ],
)
def test_spikes_and_missing_values_stop_nothing(servos: Reporting) -> None:
    assert walked(servos) is None
    assert not servos.limp


def test_a_fall_outweighs_a_low_battery_and_a_low_battery_an_expired_command() -> None:
    guard = Guard(Reporting())
    for reason in ("expired", "low battery: 8.0 V", "hot: leg 1 coxa 70 C"):
        guard.stop(reason)
    assert guard.stopped == "low battery: 8.0 V"
    assert guard.stop_allows_sitting
    guard.stop("fell")
    assert (guard.stopped, guard.stop_allows_sitting) == ("fell", False)


def test_a_stop_while_it_sits_down_holds_the_pose() -> None:
    servos = Reporting()
    with Guard(servos) as guard:
        guard.clock.tick()
        guard.write(JointTargets(servos.robot.stance_angles_rad, guard.clock.now_s))
        guard.stop("low battery: 8.0 V")
        read = servos.read
        servos.read = lambda: replace(read(), stopped="estop")  # type: ignore[method-assign]
        sit_down(guard)
        assert not servos.limp
    guard = Guard(servos)
    guard.stop("fell")
    sit_down(guard)  # nothing: not connected, and not a reason to sit


def test_a_limp_robot_stays_limp_whatever_is_called_next() -> None:
    servos = Reporting(volts=lambda at_s: 11.0 if at_s < 2 else 8.6)
    with Guard(servos) as guard:
        plan = TrialPlan(gait=make_gait(servos.robot, "tripod"), duration_s=6.0)
        run_trial(guard, plan)
        assert servos.limp
        sent = len(servos.sent)
        sit_down(guard)
        run_trial(guard, plan)
        assert len(servos.sent) == sent
    with Drive(servos=Reporting(degrees=lambda at_s: 66.0 + at_s)) as drive:

        def hot() -> None:
            for _ in range(400):
                drive.step()

        with pytest.raises(EStopError):
            hot()
        robot: Any = drive._guard.unwrapped
        sent = len(robot.sent)
        with pytest.raises(EStopError):
            drive.step()
        assert len(robot.sent) == sent


@pytest.mark.parametrize("by", ["request", "poll"])
def test_whoever_stops_it_while_it_sits_down_holds_the_pose(by: str) -> None:
    servos = Reporting()
    with Guard(servos) as guard:
        guard.clock.tick()
        guard.write(JointTargets(servos.robot.stance_angles_rad, guard.clock.now_s))
        guard.stop("low battery: 8.0 V")
        ticks, asked = list[int](), list[bool]()

        def poll() -> None:
            ticks.append(1)
            if by == "poll" and len(ticks) == 20:
                asked.append(True)

        sit_down(guard, lambda: bool(asked) or (by == "request" and len(ticks) >= 20), poll)
        assert (guard.stopped, len(ticks), servos.limp) == ("estop", 20, False)


def test_a_hot_servo_that_falls_silent_does_not_hold_the_robot_for_ever() -> None:
    servos = Reporting(degrees=lambda at_s: 69.0 if at_s < 0.5 else float("nan"))
    with Guard(servos) as guard:
        guard.clock.tick()
        guard.read()
        assert guard.hot
        for _ in range(100):
            guard.clock.tick()
        guard.clear()
        guard.read()
        assert guard.stopped is None


def test_a_drive_slows_with_warm_servos_says_so_once_and_sits_when_it_is_too_hot() -> None:
    servos = Reporting(degrees=lambda at_s: 50.0 + 1.5 * at_s)
    with Drive(servos=servos, arbiter=Arbiter()) as drive:
        speeds, news = list[tuple[float, float]](), list[str]()

        def walk() -> None:
            for _ in range(1000):
                drive.command(forward_m_s=0.1)
                state = drive.step()
                assert state.servos is not None
                speeds.append((state.servos.temperatures_c[4], drive.velocity.forward_m_s))
                news.extend(drive.controller.news())

        with pytest.raises(EStopError, match="hot"):
            walk()
        assert servos.limp
    cool = max(speed for degrees, speed in speeds if degrees < 60)
    warm = min(speed for degrees, speed in speeds if degrees > 67)
    assert warm < 0.6 * cool
    assert len(news) == 1
    assert "walks slower" in news[0]


def test_joints_are_apart() -> None:
    watch = Temperatures()
    watch.take(np.array([30.0, 50.0]), 0.0)
    assert watch.take(np.array([140.0, 51.0]), 0.02).tolist() == [30.0, 51.0]


@pytest.mark.parametrize(("reading_v", "least_v"), [(None, 9.0), (float("nan"), 9.0), (1.0, None)])
def test_missing_readings_and_thresholds_are_not_low(reading_v: float | None, least_v: float | None) -> None:
    watch = BatteryWatch()
    assert not any(watch.low(reading_v, least_v, DT_S * n) for n in range(200))
