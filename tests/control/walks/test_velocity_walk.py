"""Walks whose velocity and gait change on the way: what the feet and the robot do."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl import InputError, RobotState, TrialPlan, make_gait, run_sim_trials
from hexctl.control.batch import run_sim_trial
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import GaitChange
from hexctl.control.walks.velocity_walk import FULL_SPEED_S, OVERDRIVE, VelocityWalk, nearest_phases
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.gait.posture import Posture
from hexctl.ik.legs import foot_positions_body
from hexctl.types import FloatArray
from tests.robots import shipped
from tests.trials import sim_trial, walk

NOTHING = RobotState(np.zeros(18), 0.0, True)


def start_of(*changes: GaitChange, gait: str = "demo") -> WalkStart:
    plan = TrialPlan(gait=make_gait(shipped(), gait), changes=changes)
    return WalkStart(robot=shipped(), plans=(plan,))


def feet_of(walk: VelocityWalk, steps: int) -> FloatArray:
    """Foot positions of the first steps, (steps, 6, 3)."""
    return foot_positions_body(
        shipped(), np.array([walk.targets_rad(step, NOTHING) for step in range(steps)])
    )


def speeds_m_s(feet: FloatArray) -> FloatArray:
    """Speeds of the feet from tick to tick, (steps - 1, 6)."""
    return np.asarray(np.linalg.norm(np.diff(feet, axis=0), axis=-1) / 0.02)


def test_a_raised_body_has_all_feet_lower_after_the_soft_start() -> None:
    gait = make_gait(shipped(), "demo")
    plans = [TrialPlan(gait=replace(gait, posture=Posture(body_raise=raised))) for raised in (0.0, 0.012)]
    walks = [
        VelocityWalk(WalkStart(robot=shipped(), plans=(plan,)), lambda *_: np.array([0.1, 0.0, 0.0]))
        for plan in plans
    ]
    flat, raised = (feet_of(one, 150)[..., 2] for one in walks)
    np.testing.assert_allclose((flat - raised)[100:], 0.012 * shipped().size_m, atol=1e-6)
    assert np.diff(flat - raised, axis=0).max() < 2e-4


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-1.5, 1.5)), min_size=2, max_size=6
    ),
)
def test_no_foot_jumps_and_none_leaves_its_bounds_whatever_is_asked(
    commands: list[tuple[float, float, float]],
) -> None:
    def command(step: int, _state: RobotState) -> FloatArray:
        return np.array(commands[min(step // 40, len(commands) - 1)])

    walk = VelocityWalk(start_of(), command)
    robot, gait = shipped(), make_gait(shipped(), "demo")
    feet = feet_of(walk, 40 * len(commands) + 60)
    reach_m = np.linalg.norm((feet - robot.stance_feet_body)[..., :2], axis=-1).max()
    assert reach_m <= OVERDRIVE * gait.amplitude * robot.size_m / 2 + 1e-9
    # In a swing a foot covers the longest stroke in a third of a cycle; it rises and falls by H besides, and
    # at the end of a stroke it moves by half of what strokes change.
    across_m_s = OVERDRIVE * gait.amplitude * robot.size_m * (3 * gait.pace_hz + 0.5 / FULL_SPEED_S)
    rising_m_s = 6 * gait.height * robot.size_m * gait.pace_hz
    assert speeds_m_s(feet).max() < 1.02 * np.hypot(across_m_s, rising_m_s)


def test_the_speed_grows_no_faster_than_its_limit() -> None:
    gait = make_gait(shipped(), "demo")
    walk = VelocityWalk(start_of(), lambda step, _: np.array([0.15 if step > 200 else -0.15, 0.0, 0.0]))
    before: FloatArray = np.zeros(3)
    full_m_s = gait.strokes_per_cycle * gait.amplitude * gait.pace_hz
    for step in range(400):
        walk.targets_rad(step, NOTHING)
        if step > 1:
            assert abs(walk.velocity_body[0] - before[0]) <= full_m_s / FULL_SPEED_S * 0.02 + 1e-12
        before = walk.velocity_body
    assert before[0] == pytest.approx(0.15, abs=1e-3)


def test_what_is_beyond_the_envelope_is_scaled_and_counted_with_its_direction_kept() -> None:
    asked = np.array([0.6, 0.3, 0.0])
    walk = VelocityWalk(start_of(gait="tripod"), lambda *_: asked)
    feet = feet_of(walk, 400)
    assert walk.limited_steps > 300
    standing = np.abs(feet[..., 2] - shipped().stance_feet_body[:, 2]) < 1e-9
    moved = np.diff(feet[200:, 0, :2], axis=0)[standing[200:-1, 0] & standing[201:, 0]]
    assert np.degrees(np.arctan2(-moved[:, 1], -moved[:, 0])).mean() == pytest.approx(
        np.degrees(np.arctan2(0.3, 0.6)), abs=0.5
    )
    within = VelocityWalk(start_of(), lambda *_: np.array([0.1, 0.0, 0.0]))
    feet_of(within, 200)
    assert within.limited_steps == 0


def test_haste_walks_the_same_strides_faster() -> None:
    plain, hasty = (
        VelocityWalk(start_of(gait="tripod"), lambda *_: np.array([0.08, 0.0, 0.0])) for _ in "12"
    )
    hasty.haste = np.array(1.5)
    slow, fast = feet_of(plain, 600), feet_of(hasty, 400)
    assert np.ptp(fast[150:], axis=0) == pytest.approx(np.ptp(slow[150:], axis=0), abs=0.001)
    assert hasty.leg_phases == pytest.approx(
        plain.leg_phases - 1.5 * 0.02 * 0.9 * (599 / 1.5 - 399), abs=1e-9
    )


@given(st.permutations(range(6)), st.permutations(range(6)))
def test_phases_go_the_shortest_way_to_a_shift_of_the_other_gait(one: list[int], other: list[int]) -> None:
    before, later = np.array(one) / 6, np.array(other) / 6
    changes = nearest_phases(before, later)
    reached = before + changes - later
    assert np.allclose(reached - reached[0], np.rint(reached - reached[0])), "a shift of the whole gait"
    assert np.abs(changes).max() <= 0.5 + 1e-12
    assert (np.abs(nearest_phases(before, before + 0.3)) < 1e-12).all()


def test_a_gait_changes_in_stride_without_a_jump_and_is_the_other_one_then() -> None:
    robot = shipped()
    wave = make_gait(robot, "wave")
    walk = VelocityWalk(
        start_of(GaitChange(gait=wave, at_s=4.0), gait="tripod"), lambda *_: np.array([0.15, 0.0, 0.0])
    )
    feet = feet_of(walk, 500)
    usual = speeds_m_s(feet[100:200]).max()
    assert speeds_m_s(feet[200:]).max() < 1.6 * usual
    up = feet[..., 2] > robot.stance_feet_body[:, 2] + 1e-6
    assert set(up[120:200].sum(axis=-1)) <= {0, 3}, "a tripod"
    assert set(up[340:].sum(axis=-1)) <= {1, 2, 3}
    order = [int(np.argmax(up[345:455, leg - 1] & ~up[344:454, leg - 1])) for leg in (3, 2, 1, 4, 5, 6)]
    turns = np.diff((np.array(order) - order[0]) % 56)
    assert (turns > 0).all(), "rear to front on the left, then on the right"


def test_without_a_change_the_open_loop_walk_is_nearly_the_planned_one() -> None:
    same = GaitChange(gait=make_gait(shipped(), "tripod"), at_s=3.5)
    first, second = (walk("tripod", changes=each, duration_s=4).result for each in ((), (same,)))
    assert second.distance_m == pytest.approx(first.distance_m, abs=0.01)


@pytest.mark.slow
def test_changes_in_a_batch_are_as_alone_to_the_last_bit() -> None:
    trials = []
    for hold in ("line", "none"):
        for name, then in (("demo", "wave"), ("wave", "demo")):
            change = GaitChange(gait=make_gait(shipped(), then), at_s=1.5)
            trials.append(sim_trial(name, changes=(change,), hold=hold, duration_s=4))
    assert run_sim_trials(trials) == [run_sim_trial(one) for one in trials]


def test_a_tucked_leg_stays_up_and_the_body_shifts_over_its_feet() -> None:
    robot, posture = shipped(), Posture(tucked_legs=(5,), shift=(0.0, 0.02))
    gait = replace(make_gait(robot, "wave"), posture=posture)
    outcome = walk(gait, duration_s=5)
    log, rows = outcome.log, outcome.log.rows_of("walk")
    assert outcome.result.status == "ok"
    assert not log["foot_contacts"][rows][120:, 4].any()
    feet = foot_positions_body(robot, log["requested_rad"][rows][120:])
    other = np.delete(feet - robot.stance_feet_body, 4, axis=1)
    assert other[..., 1].mean() == pytest.approx(-0.02 * robot.size_m, abs=0.002)


@pytest.mark.slow
def test_a_walk_that_is_slower_than_asked_for_says_so_alone_and_in_a_batch() -> None:
    def fast(start: WalkStart) -> VelocityWalk:
        velocity = np.broadcast_to([0.5, 0.0, 0.0], (*start.batch_shape, 3))
        return VelocityWalk(start, lambda *_: velocity)

    trials = [sim_trial(duration_s=duration_s) for duration_s in (1.0, 1.5)]
    results = run_sim_trials(trials, make_controller=fast)
    assert [result.limited_ticks for result in results] == [50, 75]
    assert results == [run_sim_trial(trial, fast) for trial in trials]


@pytest.mark.slow
def test_a_slower_gait_on_the_way_is_no_walk_without_progress_open_loop_or_held() -> None:
    robot = shipped()
    tripod = make_gait(robot, "tripod")
    change = GaitChange(gait=replace(tripod, pace_hz=0.3 * tripod.pace_hz), at_s=3.0)
    ideal_m = ideal_speed_m_s(robot, tripod, TrialPlan(gait=tripod).motion(0.0)) * (3.0 + 0.3 * 7.0)
    for hold in ("none", "line"):
        result = walk(tripod, changes=(change,), hold=hold, duration_s=10).result
        assert result.status == "ok"
        assert result.ideal_distance_m == pytest.approx(ideal_m)
        assert result.distance_m is not None
        assert 0.6 * ideal_m < result.distance_m < 1.1 * ideal_m, hold


def test_what_cannot_be_commanded_is_refused() -> None:
    with pytest.raises(InputError, match="command"):
        feet_of(VelocityWalk(start_of(), lambda *_: np.zeros(2)), 2)
    walk = VelocityWalk(start_of())
    walk.glide_to(make_gait(shipped(), "wave"))
    with pytest.raises(InputError, match="gaits"):
        walk.glide_to([make_gait(shipped(), "wave")] * 2)
