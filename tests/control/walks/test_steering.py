"""The law of steering and dead reckoning: on made-up bodies, and with sensors that fail."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl import InputError, RobotState
from hexctl.control.walks.dead_reckoning import BLOCK_TICKS, DeadReckoning
from hexctl.control.walks.sensor_loss import JUMP_M, FrozenSensor, Measured, frozen_rows
from hexctl.control.walks.steering import Course, CourseHold
from hexctl.ik.legs import solve_legs
from hexctl.types import BoolArray, FloatArray
from tests.robots import shipped

DT_S = 0.02


def state_of(position_m: FloatArray | None, yaw_rad: FloatArray | None) -> RobotState:
    """State of one robot or several, (..., 2) and (...)."""
    position = None if position_m is None else np.concatenate([position_m, 0 * position_m[..., :1]], axis=-1)
    quaternion = None
    if yaw_rad is not None:
        half, zero = np.asarray(yaw_rad) / 2, np.zeros(np.shape(yaw_rad))
        quaternion = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
    return RobotState(np.zeros(18), 0.0, True, position, quaternion)


class Body:
    """A body that moves as commanded, but is pulled aside, turned, and sways with its steps.

    Args:
        pull_m_s: drift in the body frame, (..., 2).
        turn_rad_s: drift of the yaw, (...).
    """

    def __init__(self, pull_m_s: FloatArray, turn_rad_s: FloatArray, cycle_s: float = 1.0) -> None:
        self.position_m, self.yaw_rad = np.zeros(pull_m_s.shape), np.zeros(pull_m_s.shape[:-1])
        self._pull_m_s, self._turn_rad_s, self._cycle_s = pull_m_s, turn_rad_s, cycle_s
        self._time_s = 0.0

    def move(self, velocity_body: FloatArray) -> None:
        forward, left = (velocity_body[..., axis] + self._pull_m_s[..., axis] for axis in (0, 1))
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        self.position_m = self.position_m + DT_S * np.stack(
            [cos * forward - sin * left, sin * forward + cos * left], axis=-1
        )
        self.yaw_rad = self.yaw_rad + DT_S * (velocity_body[..., 2] + self._turn_rad_s)
        self._time_s += DT_S

    @property
    def swaying(self) -> RobotState:
        """What is measured: the body sways by 1 cm and 2 degrees in each cycle."""
        sway = math.sin(math.tau * self._time_s / self._cycle_s)
        return state_of(
            self.position_m + np.array([0.0, 0.01 * sway]), self.yaw_rad + math.radians(2.0) * sway
        )


def law(shape: tuple[int, ...] = (), *, course: Course | None = None, **options: Any) -> CourseHold:
    given: dict[str, Any] = {
        "speed_m_s": np.full(shape, 0.15)[()],
        "cycle_s": np.full(shape, 1.0)[()],
        "stride_m": np.full(shape, 0.15)[()],
        "most_turn_rad_s": np.full(shape, 0.25)[()],
    }
    return CourseHold(
        course or Course(origin_world=np.zeros(2), heading_rad=0.0, yaw_rad=0.0), **given | options
    )


def test_a_body_that_is_pulled_aside_and_turned_comes_back_to_its_line() -> None:
    random = np.random.default_rng(11)
    body = Body(random.uniform(-0.05, 0.05, (50, 2)), random.uniform(-0.05, 0.05, 50))
    hold = law((50,))
    for _ in range(3000):
        body.move(hold.update(DT_S, body.swaying))
    assert np.abs(body.position_m[:, 1]).max() < 0.01
    assert (body.position_m[:, 0] > 5.0).all()
    assert np.abs(body.yaw_rad).max() < math.radians(12)


def test_a_heading_alone_is_kept_whatever_the_position_says() -> None:
    body, hold, blind = Body(np.array([0.0, 0.02]), np.array(0.03)), law(hold="heading"), law(hold="heading")
    for _ in range(1500):
        seen = body.swaying
        velocity = hold.update(DT_S, seen)
        without = RobotState(seen.joint_positions_rad, 0.0, True, None, seen.base_quaternion_world)
        np.testing.assert_array_equal(blind.update(DT_S, without), velocity)
        body.move(velocity)
    assert abs(body.yaw_rad) < math.radians(8)
    assert body.position_m[1] == pytest.approx(0.02 * 30, abs=0.15), "a sideways pull is not seen"


def test_one_robot_is_as_in_a_batch_to_the_last_bit() -> None:
    random = np.random.default_rng(5)
    alone, batch = law(), law((3,))
    for _ in range(200):
        position, yaw = random.normal(0, 0.1, (3, 2)), random.normal(0, 0.3, 3)
        together = batch.update(DT_S, state_of(position, yaw))
        np.testing.assert_array_equal(alone.update(DT_S, state_of(position[1], yaw[1])), together[1])


def test_a_position_that_is_lost_leaves_what_is_known_of_the_pull_and_comes_back_smoothly() -> None:
    body, hold = Body(np.array([0.0, 0.03]), np.array(0.0)), law()
    velocities = []
    for step in range(4000):
        lost = 2000 <= step < 2500
        seen = body.swaying
        velocities.append(hold.update(DT_S, state_of(None, body.yaw_rad) if lost else seen))
        body.move(velocities[-1])
        if step == 2499:
            assert abs(body.position_m[1]) < 0.1, "10 s without a position: 30 cm without the integral"
    assert abs(body.position_m[1]) < 0.01
    steps = np.abs(np.diff(np.array(velocities), axis=0))
    assert steps[1990:2600].max() < 0.01, "no lurch"


def test_a_pose_that_jumps_is_not_followed_and_believed_when_it_stays() -> None:
    measured = Measured(np.array(0.0), JUMP_M)
    for _ in range(50):
        measured.update(np.array(1.0), DT_S)
    assert (float(measured.value), bool(measured.fresh)) == (0.0, False), "not even the first one"
    measured.update(np.array(0.03), DT_S)
    assert (float(measured.value), bool(measured.fresh)) == (0.03, True)
    for count in range(1000):
        measured.update(np.array(1.0 + 1e-6 * count), DT_S)
    assert float(measured.value) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("repeats", [200, 201])
@pytest.mark.parametrize("dropouts", [0, 120])
def test_a_frozen_value_is_judged_alike_during_the_walk_and_after_it(repeats: int, dropouts: int) -> None:
    values = np.arange(400.0)
    values[20 : 20 + repeats] = values[19]
    values = np.insert(values, 40, np.full(dropouts, np.nan))
    sensor = FrozenSensor()
    seen = np.array([sensor.update(DT_S, np.array([value, n])) for n, value in enumerate(values)])
    live = seen[:, 0] & np.isfinite(values)
    assert not seen[:, 1].any(), "another sensor that moves"
    after = frozen_rows(values[:, np.newaxis], DT_S)
    assert live.any() == after.any() == (repeats > 200)
    assert not (live & ~after).any()
    assert after.sum() == (repeats if repeats > 200 else 0)


def test_a_yaw_that_freezes_turns_nothing_for_ever() -> None:
    """The body is turned all the time, and its yaw stops being measured while it is 10 degrees off."""
    for hold in ("line", "heading"):
        body, law_of_hold = Body(np.array([0.0, 0.0]), np.array(math.radians(1.0))), law(hold=hold)
        frozen_rad = np.array(math.radians(10.0))
        for step in range(3000):
            seen = body.swaying
            if step >= 500:
                seen = replace(seen, base_quaternion_world=state_of(None, frozen_rad).base_quaternion_world)
            body.move(law_of_hold.update(DT_S, seen))
        turned_deg = math.degrees(abs(float(body.yaw_rad)))
        assert turned_deg < (35 if hold == "line" else 70), "60 degrees in a minute with nothing held"
        if hold == "line":
            assert abs(body.position_m[1]) < 0.05


@pytest.mark.parametrize("yaw_rad", [2 * math.pi, -2 * math.pi])
def test_a_course_with_a_whole_turn_more_is_the_same_course(yaw_rad: float) -> None:
    velocities = []
    for turns_rad in (0.0, yaw_rad):
        body, hold = Body(np.array([0.0, 0.03]), np.array(0.02)), law()
        for step in range(1500):
            if step == 1000:
                heading_rad = 0.3 + turns_rad
                hold.follow(
                    Course(origin_world=body.position_m[:2], heading_rad=heading_rad, yaw_rad=turns_rad)
                )
            body.move(hold.update(DT_S, body.swaying))
        velocities.append(hold.velocity_body)
    np.testing.assert_allclose(velocities[0], velocities[1], atol=1e-9)


def test_what_cannot_be_held_is_refused() -> None:
    with pytest.raises(InputError, match="hold"):
        law(hold="both")


# Dead reckoning of a made-up body whose feet stay on the floor


#: `ant` with feet as small as points.
POINT_FEET = replace(shipped(), foot_radius_m=1e-9)

STANDING = np.array([True, False, True, True, True, False])

#: Motion of the body in a tick, in its own frame, and its yaw relative to the line.
STEP_M, OFF_RAD = np.array([1e-3, 2.5e-4, 0.0]), 0.3

ACROSS_M = BLOCK_TICKS * (np.sin(OFF_RAD) * STEP_M[0] + np.cos(OFF_RAD) * STEP_M[1])


def reckoned(
    reckoning: DeadReckoning,
    contacts: BoolArray | None = STANDING,
    *,
    measured: bool = True,
    lifted: int = BLOCK_TICKS // 2,
    first: int = 0,
    ticks: int = BLOCK_TICKS + 3,
) -> FloatArray:
    """The deviation after a block, in which the body moves and its feet stay, but for one that lifts."""
    for tick in range(first, first + ticks):
        feet_body = POINT_FEET.stance_feet_body - (tick - BLOCK_TICKS / 2) * STEP_M
        joints_rad = solve_legs(POINT_FEET, feet_body).joint_positions_rad
        touching = None if contacts is None else contacts & (np.arange(6) != 0 if tick >= lifted else True)
        state = RobotState(joints_rad, 0.0, measured, foot_contacts=touching)
        deviation_m = reckoning.update(state, np.float64(OFF_RAD))  # type: ignore[arg-type]
    return deviation_m


def test_a_body_that_moves_over_its_feet_is_off_by_its_motion_across_the_line() -> None:
    reckoning = DeadReckoning(POINT_FEET, (), 0.02)
    assert reckoned(reckoning, ticks=BLOCK_TICKS + 2) == 0.0, "a block counts when it is complete"
    reckoning.restart()
    assert reckoned(reckoning) == pytest.approx(ACROSS_M, rel=1e-6)
    reckoning.restart()
    assert reckoned(reckoning) == pytest.approx(ACROSS_M, rel=1e-6)


def test_the_line_of_dead_reckoning_is_seen_from_the_measured_yaw() -> None:
    seen_rad: list[FloatArray] = []

    class Reckoning(DeadReckoning):
        def update(self, state: RobotState, yaw_rad: FloatArray) -> FloatArray:
            seen_rad.append(yaw_rad)
            return super().update(state, yaw_rad)

    course = Course(origin_world=np.zeros(2), heading_rad=0.3, yaw_rad=0.1)
    reckoning = Reckoning(POINT_FEET, (), DT_S)
    hold = law(course=course, hold="heading", trim_rad=0.05, dead_reckoning=reckoning)
    hold.update(DT_S, state_of(None, np.array(0.12)))
    assert seen_rad == [pytest.approx(0.12 - 0.35)]


def test_without_contacts_or_measured_angles_it_is_unknown() -> None:
    reckoning = DeadReckoning(POINT_FEET, (), 0.02)
    assert np.isnan(reckoned(reckoning, None))
    assert np.isnan(reckoned(reckoning, measured=False))
    assert reckoned(reckoning) == pytest.approx(ACROSS_M, rel=1e-6)


def test_contacts_that_never_change_are_not_believed() -> None:
    for contacts in (np.zeros(6, dtype=bool), STANDING):
        assert reckoned(DeadReckoning(POINT_FEET, (), 0.02), contacts, lifted=BLOCK_TICKS + 3) == 0.0


def test_a_sensor_that_has_frozen_is_not_believed_for_ever_whatever_else_moves() -> None:
    sensor = FrozenSensor()
    for step in range(500):
        frozen = sensor.update(DT_S, np.array([0.01 * step / 500, 0.1]), np.array([0.004, 0.004]))
    assert frozen.tolist() == [False, True]
