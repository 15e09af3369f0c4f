"""A session in simulation: what devices ask for is done, and release and silence end in a stand in time."""

import math
import os
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.base import simulation_of
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.servos import SimServos
from hexctl.control.drive.arbiter import Arbiter
from hexctl.control.drive.drive import Drive
from hexctl.control.guard import Guard
from hexctl.robot.rotations import about_z
from hexctl.teleop.drive_session import DriveSession, Travel, name_of
from hexctl.teleop.keyboard import Keyboard
from hexctl.types import N_JOINTS, RobotState
from hexctl.waiting import wait_for
from tests.robots import ROBOT_NAMES

#: A body slower than this is at rest: a thousandth of what `ant` walks.
REST_M_S = 0.01

#: Within what a robot has to be at rest that is let go of, and one that hears nothing more; ticks add up to
#: a little more or less.
RELEASE_S, SILENCE_S, ROUNDING_S = 0.3, 0.8, 1e-9


@pytest.fixture(scope="module", params=["ant", "pexod", "lukas"])
def session(request: pytest.FixtureRequest) -> Iterator[DriveSession]:
    guard = Guard(SimServos(request.param))
    with Drive(servos=guard, arbiter=Arbiter(lambda: guard.clock.now_s)) as drive:
        drive.reset()
        yield DriveSession(drive)


def speed_m_s(drive: Drive) -> float:
    """Speed of the body in the next tick, by its true poses."""
    places = []
    for step in (True, False):
        pose = simulation_of(drive.guard).true_pose
        assert pose is not None
        places.append(pose[0][:2])
        if step:
            drive.step()
    return float(np.linalg.norm(places[1] - places[0])) / PERIOD_S


def rest_after_s(drive: Drive) -> float:
    """Time until no target moves and the body rests."""
    ticks = 1
    while speed_m_s(drive) >= REST_M_S or not drive.at_rest:
        ticks += 1
    return ticks * PERIOD_S


@pytest.mark.slow
def test_a_release_at_any_moment_and_a_silence_end_in_a_stand(session: DriveSession) -> None:
    drive, random = session.drive, np.random.default_rng(1)
    stick = drive.arbiter.source("gamepad")
    released, silent = [], []
    for number in range(6):
        shares = random.uniform(-0.7, 0.7, 3)
        for _ in range(60 + int(random.integers(0, 60))):
            stick.command(drive.share(*shares))
            drive.step()
        if number % 2:
            stick.release()
            released.append(rest_after_s(drive))
        else:
            silent.append(rest_after_s(drive))
    assert max(released) <= RELEASE_S
    assert max(silent) <= SILENCE_S


def stopped_after_s(drive: Drive, ticks: int = 70) -> float:
    """Time from which on the body is slower than a tenth of the greatest speed."""
    slow_m_s = 0.1 * drive.controller.most[0]  # type: ignore[attr-defined]
    fast = [tick for tick in range(1, ticks + 1) if speed_m_s(drive) > slow_m_s]
    return PERIOD_S * max(fast, default=0)


@pytest.mark.soak
@pytest.mark.parametrize("gait", ["tripod", "wave"])
@pytest.mark.parametrize("robot", ROBOT_NAMES)
def test_bodies_rest_in_time_a_hundred_times_of_a_hundred(
    robot: str, gait: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The figures of docs/results/results.md, on the simulation's clock."""
    guard, random = Guard(SimServos(robot)), np.random.default_rng(7)
    after_s: dict[str, list[float]] = {"release": [], "silence": []}
    with Drive(servos=guard, gait=gait, arbiter=Arbiter(lambda: guard.clock.now_s)) as drive:
        drive.reset()
        stick = drive.arbiter.source("gamepad")
        for number in range(200):
            shares = random.uniform(-1, 1, 3)
            for _ in range(110 + int(random.integers(0, 80))):
                stick.command(drive.share(*shares))
                drive.step()
            if number % 2:
                stick.release()
            after_s["release" if number % 2 else "silence"].append(stopped_after_s(drive))
        assert drive.noticed == ()  # no leg is accused for a hard halt
    with capsys.disabled():
        for why, times_s in after_s.items():
            sys.stdout.write(f"\n{robot} {gait} {why}: {np.median(times_s):.2f}, {max(times_s):.2f} s\n")
    assert max(after_s["release"]) <= RELEASE_S + ROUNDING_S
    assert max(after_s["silence"]) <= SILENCE_S + ROUNDING_S


class Script:
    """A device that asks for something at ticks, and keeps what it is told and what the robot was doing."""

    def __init__(self, session: DriveSession, requests: dict[int, str]) -> None:
        self._session, self._requests = session, requests
        self.told = dict[str, Any]()
        self.seen: list[tuple[float, float, str]] = []

    def poll(self) -> None:
        if (request := self._requests.get(len(self.seen))) is not None:
            self._session.ask(request)
        drive = self._session.drive
        self.seen.append((drive.body_pose.up_m, drive.velocity.forward_m_s, self._session.said))

    def report(self, status: dict[str, Any]) -> None:
        self.told = status


@pytest.mark.parametrize(
    ("last", "stopped", "source"), [("quit", "quit", "motion"), ("stop", "stop button", None)]
)
def test_what_is_asked_for_is_done_and_a_stop_holds(last: str, stopped: str, source: str | None) -> None:
    with Drive("ant") as drive:
        session = DriveSession(drive)
        drive.command(forward_m_s=0.1)
        script = Script(session, {110: "gait", 115: "up", 120: "up", 125: "down", 190: last, 230: "quit"})
        session.run([script])
        assert name_of(drive.gait.slots) == script.told["gait"] == "wave"
        assert drive.body_pose.up_m == pytest.approx(0.01)
        assert drive.at_rest
        assert drive.stopped == stopped
        assert script.told["source"] == source


@pytest.mark.slow
def test_the_body_goes_no_higher_and_no_lower_than_the_legs_reach() -> None:
    with Drive("ant") as drive:
        session = DriveSession(drive)
        requests = dict.fromkeys(range(150, 170), "up") | dict.fromkeys(range(400, 430), "down")
        script = Script(session, requests | {600: "level", 700: "quit"})
        drive.command(forward_m_s=drive.share(0.5).forward_m_s)
        session.run([script])
    highest, lowest, level = script.seen[395], script.seen[595], script.seen[695]
    assert highest[0] > 0.03 > -0.03 > lowest[0]
    assert min(highest[1], lowest[1]) > 0
    assert highest[2] == lowest[2] == "the legs do not reach further"
    assert level[0] == 0


def test_a_height_at_which_nothing_walks_is_said() -> None:
    with Drive("ant", body_raise=0.1) as drive:
        session = DriveSession(drive)
        drive.command(forward_m_s=0.1)
        script = Script(session, {250: "quit"})
        session.run([script])
        assert "body height" in script.told["said"]
        assert script.told["velocity"] == [0, 0, 0]


class Cooking(SimServos):
    """A robot with a servo that gets warm after 50 readings."""

    reads = 0

    def read(self) -> RobotState:
        """The state, with a warning."""
        self.reads += 1
        warm = (f"warm, {60 + self.reads // 20} degrees C: leg 2 femur (id 5)",) if self.reads > 50 else ()
        return replace(super().read(), warnings=("firmware differs", *warm))


def test_a_new_warning_of_the_servos_is_said() -> None:
    with Drive(servos=Cooking("ant")) as drive:
        session = DriveSession(drive)
        script = Script(session, {500: "quit"})
        session.run([script])
        assert script.seen[100][2] == "servos: warm, 62 degrees C: leg 2 femur (id 5)"
        assert script.seen[500][2] == ""
        (warned,) = session.warned
        assert warned.endswith(": leg 2 femur (id 5)")


def test_a_crowd_of_requests_keeps_no_other_from_being_done() -> None:
    with Drive("ant") as drive:
        session = DriveSession(drive)
        drive.stop()
        for _ in range(1000):
            session.ask("gait")
        session.ask("stand")
        for _ in range(100):
            session.ask("gait")
        for _ in range(2):
            session._do_requests()
        assert drive.arbiter.stopped is None


def test_a_stop_while_a_stand_is_being_done_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    with Drive("ant") as drive:
        session = DriveSession(drive)
        stand, stopper = drive.stand, threading.Thread(target=session.ask, args=("stop",))

        def interrupted() -> None:
            stopper.start()
            wait_for(lambda: drive.arbiter.stopped, 5.0, "the stop does not arrive")
            stand()

        monkeypatch.setattr(drive, "stand", interrupted)
        session.ask("stand")
        session._do_requests()
        stopper.join(5.0)
        assert drive.arbiter.stopped == "stop button"


def test_a_robot_with_a_latched_stop_shows_no_speed_of_before() -> None:
    class Latch:
        clear_command, trouble = "clear it", None

        def press(self) -> None:
            guard.stop("estop")

    guard = Guard(SimServos("ant"))
    with Drive(servos=guard, arbiter=Arbiter(lambda: guard.clock.now_s)) as drive:
        session = DriveSession(drive, Latch())  # type: ignore[arg-type]
        drive.command(forward_m_s=0.1)
        session.run([Script(session, {199: "quit"})])
        state = guard.peek()
        assert session.status(state)["speed_m_s"] > 0.05
        session.ask("stop")
        shown = session.status(state)
        assert (shown["speed_m_s"], shown["velocity"]) == (None, [0, 0, 0])


def test_a_status_draws_each_leg_and_its_state() -> None:
    with Drive("ant", failure="5:locked") as drive:
        state = drive.reset()
        feet_rad = state.joint_positions_rad.copy()
        feet_rad[1] += 0.3  # lifts leg 1
        session = DriveSession(drive)
        legs = session.status(replace(state, joint_positions_rad=feet_rad))["legs"]
        assert [leg["state"] for leg in legs] == ["air", "", "", "", "failed", ""]
        np.testing.assert_allclose(np.hypot(*legs[1]["points"][-1][:2]), 1.0, atol=0.05)
        assert session.status(replace(state, joint_positions_rad=np.full(18, np.nan)))["legs"] == []


def test_an_interrupt_before_the_first_command_commands_nothing() -> None:
    guard = Guard(SimServos("ant"))
    with Drive(servos=guard) as drive:
        begun_s = guard.clock.now_s
        session = DriveSession(drive)
        assert session.run(stop_requested=lambda: True) == "interrupted"
        assert not session.commanded
        assert guard.clock.now_s == begun_s


def test_travel_is_the_length_of_a_path_its_speed_and_the_turn() -> None:
    travel = Travel()
    assert (travel.distance_m, travel.speed_m_s, travel.heading_deg) == (None, None, None)
    for tick in range(21):  # 0.3 m forward, then 1.2 m to the left, turning by 90 degrees
        way = 0.075 * tick
        state = RobotState(
            joint_positions_rad=np.zeros(N_JOINTS),
            stamp_s=0.0,
            measured=True,
            base_position_world=np.array([min(way, 0.3), max(way - 0.3, 0.0), 0.1]),
            base_quaternion_world=about_z(math.radians(170 + 4.5 * tick)),
        )
        travel.add(state, 0.15 * tick)
    assert travel.distance_m == pytest.approx(1.5, abs=0.03)
    assert travel.speed_m_s == pytest.approx(0.5, rel=0.25)
    assert travel.heading_deg == pytest.approx(90.0)


class Typed(Keyboard):
    """A keyboard on which keys are pressed at ticks; the greatest speed after each."""

    def __init__(self, session: DriveSession, keys: dict[int, str]) -> None:
        self._reading, self.writing = os.pipe()
        drive = session.drive
        super().__init__(
            drive.arbiter.source("keyboard"), drive.share, session.ask, self._reading, lambda _: None
        )
        self._drive, self._typed = drive, keys
        self._tick, self._last = 0, ""
        self.speeds_m_s = dict.fromkeys(keys.values(), 0.0)

    def poll(self) -> None:
        if keys := self._typed.get(self._tick, ""):
            os.write(self.writing, keys.encode())
            self._last = keys
        super().poll()
        self._tick += 1
        if self._last:
            now_m_s = abs(self._drive.velocity.forward_m_s)
            self.speeds_m_s[self._last] = max(now_m_s, self.speeds_m_s[self._last])


@pytest.mark.slow
@pytest.mark.parametrize("down", ["x", "0"])
def test_a_robot_that_is_told_to_stand_does_not_walk_off_at_the_speed_of_before(down: str) -> None:
    with Drive("ant") as drive:
        session = DriveSession(drive)
        # The key after the stop, or after sitting down, moves nothing either.
        typed = Typed(session, {115: "ww", 160: down, 290: "w", 300: "1", 450: "www", 500: "q"})
        session.run([typed])
        assert typed.speeds_m_s["ww"] > 0.05
        assert typed.speeds_m_s["1"] == 0.0
        assert typed.speeds_m_s["www"] > 0.08
