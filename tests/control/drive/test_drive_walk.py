"""The feet of a walk that is driven: from any moment to a stand, and never further than they may."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.drive.drive_walk import FASTEST_SWING, HALT_S, DriveWalk
from hexctl.control.drive.velocity_limits import VelocityLimits
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.velocity_walk import OVERDRIVE, VelocityWalk
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.ik.legs import foot_positions_body
from hexctl.types import FloatArray, RobotState
from tests.robots import ROBOT_NAMES, shipped

NOTHING = RobotState(np.zeros(18), 0.0, True)
PERIOD_S = 0.02


class Driven:
    """A walk and the velocity that is asked of it."""

    def __init__(self, name: str = "ant", gait: str = "tripod") -> None:
        self.robot = shipped(name)
        self.gait = make_gait(self.robot, gait)
        plan = TrialPlan(gait=self.gait)
        start = WalkStart(
            robot=self.robot, plans=(plan,), batch_shape=(), period_s=PERIOD_S, turned_rad=0.0, frame=None
        )
        self.wanted: FloatArray = np.zeros(3)
        self.walk = DriveWalk(start, lambda: self.wanted)
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


@pytest.mark.parametrize("gait", ["tripod", "wave", "demo"])
def test_at_a_constant_velocity_the_feet_are_those_of_a_velocity_walk(gait: str) -> None:
    driven = Driven(gait=gait)
    velocity = np.array([0.06, 0.03, 0.1])
    driven.wanted = velocity
    plan = TrialPlan(gait=driven.gait)
    start = WalkStart(
        robot=driven.robot, plans=(plan,), batch_shape=(), period_s=PERIOD_S, turned_rad=0.0, frame=None
    )
    other = VelocityWalk(start, lambda _step, _state: velocity)
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
    assert driven.walk.at_rest
    assert driven.walk.home
    np.testing.assert_allclose(feet[-1], driven.robot.stance_feet_body, atol=0.02 * driven.gait.amplitude)


def test_it_is_watched_only_while_its_feet_step_at_their_height() -> None:
    driven = Driven()
    driven.feet(10)
    assert driven.walk.leg_phases is None
    driven.wanted = np.array([0.1, 0.0, 0.0])
    driven.feet(20)
    assert driven.walk.leg_phases is not None


def test_a_stop_ends_it_whatever_is_asked_for() -> None:
    driven = Driven()
    driven.wanted = np.array([0.1, 0.0, 0.0])
    driven.feet(60)
    driven.walk.stop(driven.step)
    assert not driven.walk.done(driven.step, NOTHING)
    driven.feet(12)
    assert driven.walk.done(driven.step, NOTHING)


def test_a_batch_is_refused() -> None:
    robot = shipped()
    plan = TrialPlan(gait=make_gait(robot, "tripod"))
    start = WalkStart(
        robot=robot, plans=(plan, plan), batch_shape=(2,), period_s=PERIOD_S, turned_rad=0.0, frame=None
    )
    with pytest.raises(InputError, match="drive: got a batch of 2 robots; allowed: one robot"):
        DriveWalk(start, lambda: np.zeros(3))
