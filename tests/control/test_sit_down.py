"""A guard that stops for a low battery or heat lets the robot sit down. No wall clock."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.mock import MockServos
from hexctl.control.controllers import sitting_angles_rad
from hexctl.control.drive.arbiter import Arbiter
from hexctl.control.drive.drive import Drive
from hexctl.control.guard import Guard
from hexctl.control.sit_down import sit_down
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import EStopError
from hexctl.gait.gait import make_gait
from hexctl.types import JointTargets, RobotState
from tests.backends.fake_time import FakeTime
from tests.control.posed import readings
from tests.robots import shipped


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
