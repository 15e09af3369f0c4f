"""The feet, the limits and the corrections of a walk that is driven."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl import RobotState, TrialPlan, make_gait
from hexctl.control.drive.drive_walk import FASTEST_SWING, HALT_S, DriveWalk
from hexctl.control.drive.velocity_hold import MOST, VelocityHold
from hexctl.control.planning.speed_envelope import POINTS, VelocityLimits
from hexctl.control.preparation import WalkStart
from hexctl.control.walks.velocity_walk import OVERDRIVE, VelocityWalk
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.rotations import about_z
from hexctl.types import FloatArray
from tests.robots import ROBOT_NAMES, shipped

NOTHING = RobotState(np.zeros(18), 0.0, True)


PERIOD_S = 0.02


class Driven:
    """A walk and the velocity that is asked of it."""

    def __init__(self, name: str = "ant", gait: str = "tripod") -> None:
        self.robot = shipped(name)
        self.gait = make_gait(self.robot, gait)
        plan = TrialPlan(gait=self.gait)
        self.start = WalkStart(robot=self.robot, plans=(plan,))
        self.wanted: FloatArray = np.zeros(3)
        self.walk = DriveWalk(self.start, lambda: self.wanted)
        self.limits = VelocityLimits.of(self.robot, self.gait)
        self.step = -1

    def feet(self, steps: int) -> FloatArray:
        """Feet of the next steps, (steps, 6, 3)."""
        rows = []
        for _ in range(steps):
            self.step += 1
            rows.append(self.walk.targets_rad(self.step, NOTHING))
        return foot_positions_body(self.robot, np.array(rows))

    def until_at_rest(self) -> FloatArray:
        """Feet until it is at rest, (steps, 6, 3)."""
        rows = [self.feet(1)]
        while not self.walk.at_rest:
            rows.append(self.feet(1))
        return np.concatenate(rows)


@pytest.mark.parametrize("gait", ["tripod", "demo"])
def test_at_a_constant_velocity_the_feet_are_those_of_a_velocity_walk(gait: str) -> None:
    driven = Driven(gait=gait)
    velocity = np.array([0.06, 0.03, 0.1])
    driven.wanted = velocity
    other = VelocityWalk(driven.start, lambda _step, _state: velocity)
    driven.feet(400)
    for step in range(400):
        other.targets_rad(step, NOTHING)
    phases = driven.walk.leg_phases
    assert phases is not None
    other._cycles = driven.walk._cycles - driven.gait.pace_hz * PERIOD_S
    theirs = [other.targets_rad(400 + step, NOTHING) for step in range(80)]
    np.testing.assert_allclose(
        driven.feet(79), foot_positions_body(driven.robot, np.array(theirs))[1:], atol=2e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOT_NAMES)
@given(
    st.lists(
        st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1), st.integers(1, 90)),
        min_size=1,
        max_size=6,
    ),
    st.sampled_from(["tripod", "wave", "demo", "ripple"]),
)
def test_whatever_is_asked_no_foot_jumps_or_gets_too_far_and_zero_is_a_stand_in_time(
    name: str, commands: list[tuple[float, float, float, int]], gait: str
) -> None:
    driven = Driven(name, gait)
    most = np.array([*[driven.limits.speeds_m_s[0, 0]] * 2, driven.limits.turn_rates_rad_s[0]])
    rows = []
    for *share, steps in commands:
        driven.wanted = driven.limits.limited(np.array(share) * most)
        rows.append(driven.feet(steps))
    driven.wanted = np.zeros(3)
    rows.append(driven.until_at_rest())
    assert len(rows[-1]) * PERIOD_S <= HALT_S + 2 * PERIOD_S
    rows.append(driven.feet(30))
    feet = np.concatenate(rows)
    # At rest: all feet on the floor, and none moves.
    assert (feet[-30:] == feet[-1]).all()
    np.testing.assert_allclose(feet[-1, :, 2], driven.robot.stance_feet_body[:, 2], atol=1e-9)
    stroke_m = driven.gait.amplitude * driven.robot.size_m
    away_m = np.linalg.norm((feet - driven.robot.stance_feet_body)[..., :2], axis=-1)
    assert away_m.max() <= OVERDRIVE * stroke_m / 2 * 1.02
    # The fastest is a swing over the longest stroke, a little late, at the height's own speed.
    swing_s = 1 / 3 / driven.gait.pace_hz
    height_m_s = (
        2 * driven.gait.height * driven.robot.size_m / swing_s
        + driven.gait.height * driven.robot.size_m / HALT_S
    )
    speeds = np.linalg.norm(np.diff(feet, axis=0), axis=-1) / PERIOD_S
    assert speeds.max() <= np.hypot(FASTEST_SWING * OVERDRIVE * stroke_m / swing_s, height_m_s)


def test_feet_go_home_when_told_to_and_not_before() -> None:
    driven = Driven()
    driven.wanted = np.array([0.1, 0.0, 0.0])
    driven.feet(57)
    driven.wanted = np.zeros(3)
    driven.feet(100)
    assert driven.walk.at_rest
    assert not driven.walk.home
    driven.walk.go_home()
    feet = driven.feet(100)
    driven.walk.go_home()  # in its places already, it does not step
    assert driven.walk.at_rest
    assert driven.walk.home
    np.testing.assert_allclose(feet[-1], driven.robot.stance_feet_body, atol=0.02 * driven.gait.amplitude)


def test_it_is_watched_only_while_its_feet_step_at_their_height() -> None:
    driven = Driven()
    driven.feet(10)
    assert driven.walk.leg_phases is None
    driven.wanted = np.array([0.1, 0.0, 0.0])
    driven.feet(60)
    assert driven.walk.leg_phases is not None


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_limits_are_those_of_the_envelope_for_any_order_of_the_legs(name: str) -> None:
    robot = shipped(name)
    gait = make_gait(robot, "wave")
    limits, finer = VelocityLimits.of(robot, gait), VelocityLimits.of(robot, gait, POINTS)
    np.testing.assert_allclose(limits.speeds_m_s, finer.speeds_m_s, rtol=0.05)
    np.testing.assert_allclose(limits.turn_rates_rad_s, finer.turn_rates_rad_s, rtol=0.05)
    assert VelocityLimits.of(robot, make_gait(robot, "tripod")) is limits


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-5, 5), st.sampled_from([(), (3,), (2, 5)]))
def test_a_velocity_keeps_its_direction_and_shares_the_strokes(
    forward: float, left: float, turn: float, failed: tuple[int, ...]
) -> None:
    limits = VelocityLimits.of(shipped(), make_gait(shipped(), "tripod"))
    velocity = np.array([forward, left, turn])
    limited = limits.limited(velocity, failed)
    speed, rate = math.hypot(*limited[:2]), abs(limited[2])
    most_m_s, most_rad_s = limits.speeds_m_s[0, 0], limits.turn_rates_rad_s[0]  # alike for all, of `ant`
    assert speed / most_m_s + rate / most_rad_s <= 1 + 1e-9
    share = float(np.linalg.norm(limited)) / max(float(np.linalg.norm(velocity)), 1e-300)
    np.testing.assert_allclose(limited, share * velocity, atol=1e-9)
    if math.hypot(forward, left) / most_m_s + abs(turn) / most_rad_s <= 1:
        np.testing.assert_array_equal(limited, velocity)


MOST_BODY = np.array([0.2, 0.2, 1.0])


class Slipping:
    """A robot whose feet lose a share of each velocity, and what it measures of itself.

    Attributes:
        measures: what it tells: `pose`, `yaw` or nothing.
        frozen: whether what it tells stays as it is.
    """

    def __init__(self, slip: FloatArray, measures: str = "pose") -> None:
        self.hold, self.slip, self.measures = VelocityHold(), slip, measures
        self.position, self.yaw = np.zeros(2), 0.3
        self.told: RobotState | None = None
        self.frozen = False
        self.commanded: FloatArray = np.zeros(3)
        self._ticks = 0

    def state(self) -> RobotState:
        if self.frozen and self.told is not None:
            return self.told
        known: dict[str, Any] = {}
        # A step of a robot moves its sensors by more than their last bit.
        shake = 1e-9 * (self._ticks % 7)
        if self.measures != "nothing":
            known["base_quaternion_world"] = about_z(self.yaw) + np.array([0, shake, 0, 0])
        if self.measures == "pose":
            known["base_position_world"] = np.array([*self.position, 0.1]) + shake
        self.told = RobotState(np.zeros(18), 0.0, True, **known)
        return self.told

    def walk(self, wanted: FloatArray, seconds: float) -> FloatArray:
        """Mean velocity of the body in a time."""
        total = np.zeros(3)
        ticks = round(seconds / PERIOD_S)
        for _ in range(ticks):
            self._ticks += 1
            self.commanded = self.hold.update(PERIOD_S, self.state(), wanted, self.commanded, MOST_BODY)
            velocity = self.slip * self.commanded
            cos, sin = math.cos(self.yaw), math.sin(self.yaw)
            x, y, turn = (PERIOD_S * velocity).tolist()
            self.position = self.position + np.array([cos * x - sin * y, sin * x + cos * y])
            self.yaw += turn
            total += velocity
        return np.asarray(total / ticks)


@pytest.mark.parametrize(
    ("slip", "wanted"),
    [(0.8, (0.1, 0, 0)), (1.13, (0, -0.1, 0)), (0.9, (0, 0, 0.5)), (0.8, (0.05, 0.03, -0.3))],
)
def test_a_slip_that_stays_costs_no_velocity(slip: float, wanted: tuple[float, float, float]) -> None:
    robot = Slipping(np.full(3, slip))
    robot.walk(np.array(wanted), 8.0)
    np.testing.assert_allclose(robot.walk(np.array(wanted), 4.0), wanted, atol=0.03 * np.abs(wanted).max())


def test_only_what_is_measured_is_made_good_and_a_stand_is_a_stand() -> None:
    wanted = np.array([0.1, 0.0, 0.4])
    for measures, reached in (("yaw", [0.08, 0.0, 0.4]), ("nothing", [0.08, 0.0, 0.32])):
        robot = Slipping(np.full(3, 0.8), measures)
        robot.walk(wanted, 8.0)
        np.testing.assert_allclose(robot.walk(wanted, 4.0), reached, atol=0.002)
    np.testing.assert_array_equal(robot.commanded, wanted)
    robot = Slipping(np.full(3, 0.5))
    robot.walk(np.array([0.1, 0.0, 0.0]), 5.0)
    robot.walk(np.zeros(3), 0.02)
    np.testing.assert_array_equal(robot.commanded, np.zeros(3))


@pytest.mark.parametrize("what", ["position", "yaw", "frozen"])
def test_a_sensor_that_jumps_or_freezes_is_not_followed(what: str) -> None:
    robot, wanted = Slipping(np.ones(3)), np.array([0.1, 0.0, 0.0])
    robot.walk(wanted, 3.0)
    if what == "frozen":
        robot.frozen = True
        robot.walk(wanted, 6.0)
        np.testing.assert_array_equal(robot.commanded, wanted)
        return
    robot.position = robot.position + (what == "position")
    robot.yaw += what == "yaw"
    robot.walk(wanted, 0.5)
    np.testing.assert_allclose(robot.commanded, wanted, atol=0.005)


def test_the_correction_has_a_bound() -> None:
    robot = Slipping(np.zeros(3))
    robot.walk(np.array([0.1, 0.0, 0.5]), 3.0)
    assert (np.abs(robot.hold.correction) <= MOST * MOST_BODY + 1e-12).all()


@pytest.mark.parametrize("size", [0.0, 5e-324, 1e308])
def test_velocities_of_any_size_give_finite_ones(size: float) -> None:
    robot = Slipping(np.array([0.1, 0.1, 0.1]))
    for _ in range(5):
        wanted = np.array([size, -size, size])
        commanded = np.clip(wanted, -MOST_BODY, MOST_BODY)
        with np.errstate(all="raise", under="ignore", over="ignore"):
            robot.hold.update(PERIOD_S, robot.state(), wanted, commanded, MOST_BODY)
        assert np.isfinite(robot.hold.correction).all()
