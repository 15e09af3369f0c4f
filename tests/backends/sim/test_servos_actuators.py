"""From a joint target to the shaft: delay, calibration error, play and a jam, for one robot and for many."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.sim.model import FIRST_JOINT, Simulation, make_simulation
from hexctl.backends.sim.servos import ActuatorModel, SimServos
from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.testing.servos import move
from hexctl.types import FloatArray
from tests.robots import shipped

STANCE = shipped().stance_angles_rad

#: Each joint of a test hears the same targets louder or softer, some the other way round.
GAINS = np.linspace(-1.0, 1.0, 18)

#: Everything between a target and the floor that a world can change.
LOOSE = World(
    servo_delay_s=0.06,
    servo_backlash_deg=1.5,
    joint_offset_deg=1.0,
    friction_cone="pyramidal",
    time_step_s=0.004,
    added_mass_share=0.2,
    body_mass_shift_m=(0.01, -0.005, 0.005),
    contact_time_s=0.012,
    slope_deg=1.0,
)

angles = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=30)


@cache
def _simulation(failure: Failure | None = None) -> Simulation:
    return make_simulation(shipped(), World(), failure)


def _train(
    failure: Failure | None = None, *, offsets_rad: FloatArray | None = None, **world: float
) -> ActuatorModel:
    """The actuator model of a robot that stands in a world."""
    simulation = replace(_simulation(failure), world=World.model_validate(world))
    if offsets_rad is not None:
        simulation = replace(simulation, joint_offsets_rad=offsets_rad)
    return ActuatorModel.at_rest(simulation, STANCE)


def _targets(given_rad: Sequence[float]) -> FloatArray:
    """Targets about the stance, (T, 18)."""
    return STANCE + np.outer(given_rad, GAINS)


def _driven(train: ActuatorModel, targets_rad: FloatArray) -> FloatArray:
    return np.array([train.drive(target_rad) for target_rad in targets_rad])


def _loose_gear(targets_rad: Sequence[float], play_rad: float, shaft_rad: float) -> list[float]:
    """Position of one shaft after each target, from the flanks of the gear one by one."""
    shafts = []
    for target_rad in targets_rad:
        if target_rad - shaft_rad > play_rad / 2:
            shaft_rad = target_rad - play_rad / 2
        elif shaft_rad - target_rad > play_rad / 2:
            shaft_rad = target_rad + play_rad / 2
        shafts.append(shaft_rad)
    return shafts


def test_in_the_flat_world_targets_reach_the_actuators_as_they_are() -> None:
    train, targets = _train(), _targets([0.3, -0.2, 0.0])
    assert train.plain
    np.testing.assert_array_equal(_driven(train, targets), targets)
    np.testing.assert_array_equal(
        _driven(train.copies(4), np.tile(targets[:, np.newaxis], (4, 1)))[:, 2], targets
    )


@pytest.mark.parametrize(
    "train",
    [
        _train(servo_delay_s=0.02),
        _train(servo_backlash_deg=0.1),
        _train(offsets_rad=np.full(18, 0.01)),
        _train(Failure(leg=2, kind="stuck")),
    ],
    ids=["delay", "play", "offset", "jam"],
)
def test_a_train_with_a_flaw_is_not_plain(train: ActuatorModel) -> None:
    assert not train.plain
    assert not train.copies(2).plain


@given(ticks=st.integers(1, 25), given_rad=angles)
def test_a_target_arrives_as_many_ticks_late_as_the_delay_has(ticks: int, given_rad: list[float]) -> None:
    targets = _targets(given_rad)
    arrived = _driven(_train(servo_delay_s=ticks * 0.02), targets)
    asked = np.concatenate([np.tile(STANCE, (ticks, 1)), targets])
    np.testing.assert_array_equal(arrived, asked[: len(targets)])


def test_a_target_that_changes_after_it_was_given_arrives_as_it_was_given() -> None:
    train, target = _train(servo_delay_s=0.02), STANCE + 0.2
    train.drive(target)
    target[:] = 0.0
    np.testing.assert_array_equal(train.drive(target), STANCE + 0.2)


@given(play_deg=st.floats(0.01, 20.0), given_rad=angles)
def test_play_is_the_hysteresis_of_a_loose_gear(play_deg: float, given_rad: list[float]) -> None:
    targets = _targets(given_rad)
    shafts = _driven(_train(servo_backlash_deg=play_deg), targets)
    for joint in range(18):
        expected = _loose_gear(targets[:, joint].tolist(), math.radians(play_deg), STANCE[joint])
        np.testing.assert_allclose(shafts[:, joint], expected, rtol=0, atol=1e-12)


def test_a_shaft_rests_until_its_servo_has_crossed_the_play() -> None:
    train = _train(servo_backlash_deg=2.0)
    told_deg = [0.9, 3.0, 1.1, 0.5, -4.0]
    shafts = _driven(train, STANCE + np.radians(told_deg)[:, np.newaxis] * np.ones(18))
    expected = [[deg] * 18 for deg in (0.0, 2.0, 2.0, 1.5, -3.0)]
    np.testing.assert_allclose(np.degrees(shafts - STANCE), expected, atol=1e-9)


@given(given_rad=angles)
def test_delay_offset_and_play_come_in_the_order_of_the_gear(given_rad: list[float]) -> None:
    """A late target, read with the servo's error, turns a shaft that is loose."""
    offsets = np.radians(np.linspace(-3.0, 3.0, 18))
    targets = _targets(given_rad)
    shafts = _driven(_train(offsets_rad=offsets, servo_delay_s=0.04, servo_backlash_deg=3.0), targets)
    late = np.concatenate([np.tile(STANCE, (2, 1)), targets])[: len(targets)] + offsets
    for joint in range(18):
        expected = _loose_gear(late[:, joint].tolist(), math.radians(3.0), STANCE[joint] + offsets[joint])
        np.testing.assert_allclose(shafts[:, joint], expected, rtol=0, atol=1e-12)


def test_a_jammed_joint_stays_where_it_is_whatever_lies_before_it() -> None:
    stuck = Failure(leg=2, kind="stuck", joint="femur", angle_rad=0.4)
    train = _train(stuck, offsets_rad=np.full(18, 0.02), servo_delay_s=0.02, servo_backlash_deg=1.0)
    driven = _driven(train, _targets([0.5, -0.5, 0.2]))
    assert driven[:, 4].tolist() == [0.4] * 3
    moved = np.delete(np.abs(np.diff(driven, axis=0)).max(axis=0), 4)
    assert (moved > 0).all()


@given(before_rad=angles, after_rad=angles)
def test_copies_go_on_as_the_original_does(before_rad: list[float], after_rad: list[float]) -> None:
    train = _train(offsets_rad=np.radians(GAINS), servo_delay_s=0.06, servo_backlash_deg=4.0)
    _driven(train, _targets(before_rad))
    copies, targets = train.copies(3), _targets(after_rad)
    together = _driven(copies, np.repeat(targets[:, np.newaxis], 3, axis=1))
    alone = _driven(train, targets)
    for index in range(3):
        np.testing.assert_array_equal(together[:, index], alone)


def test_copies_and_their_original_leave_one_another_alone() -> None:
    """Each hears other targets than the rest, as gaits of one batch do."""
    given_rad = np.random.default_rng(3).uniform(-1, 1, (4, 20))
    targets = [_targets(row.tolist()) for row in given_rad]
    walked, *others = (_train(servo_delay_s=0.04, servo_backlash_deg=4.0) for _ in range(5))
    for train in (walked, *others):
        _driven(train, _targets([0.4, -0.1, 0.3]))
    together = _driven(walked.copies(3), np.stack(targets[:3], axis=1))
    for index in range(3):
        np.testing.assert_array_equal(together[:, index], _driven(others[index], targets[index]))
    np.testing.assert_array_equal(_driven(walked, targets[3]), _driven(others[3], targets[3]))


def _joints_after(world: World, targets_rad: Sequence[FloatArray]) -> FloatArray:
    """The true joint angles one tick after each target, (T, 18)."""
    joints = []
    with SimServos(shipped(), world=world) as servos:
        for target_rad in targets_rad:
            move(servos, target_rad, ticks=1)
            joints.append(servos.simulation.physics.data.qpos[FIRST_JOINT:].copy())
        servos.clock.tick()
        joints.append(servos.simulation.physics.data.qpos[FIRST_JOINT:].copy())
    return np.array(joints)[1:]


def test_a_robot_with_slow_servos_begins_to_move_when_the_delay_is_over() -> None:
    stood = _joints_after(World(), [STANCE] * 6)
    late = _joints_after(World(servo_delay_s=0.06), [STANCE + 0.1] * 6)
    np.testing.assert_array_equal(late[:3], stood[:3])
    assert (late[3] > stood[3]).all()


def test_a_robot_with_play_in_its_joints_does_not_follow_small_targets() -> None:
    stood = _joints_after(World(), [STANCE] * 6)
    small = _joints_after(World(servo_backlash_deg=2.0), [STANCE + math.radians(0.9)] * 6)
    np.testing.assert_array_equal(small, stood)
    large = _joints_after(World(servo_backlash_deg=2.0), [STANCE + math.radians(1.5)] * 6)
    half_behind = _joints_after(World(), [STANCE + math.radians(0.5)] * 6)
    np.testing.assert_allclose(large, half_behind, rtol=0, atol=1e-9)


@pytest.mark.parametrize("failure", [None, Failure(leg=3), Failure(leg=3, kind="stuck", angle_rad=0.2)])
def test_a_batch_with_everything_loose_equals_its_single_trials(failure: Failure | None) -> None:
    legs = (failure.leg,) if failure else ()
    trials = [
        SimTrial(
            robot=shipped(),
            plan=TrialPlan(
                gait=make_gait(shipped(), code, failed_legs=legs),
                duration_s=2.0,
                belief=failure,
                self_rotation="none",
            ),
            failure=failure,
            world=LOOSE,
            seed=5,
            facing_rad=0.7,
        )
        for code in ("1", "57", "120")
    ]
    for made, alone in zip(run_sim_trials(trials), map(run_sim_trial, trials), strict=True):
        assert made.to_dict() == alone.to_dict()
        assert np.array_equal(made.path_m, alone.path_m)
        assert len(made.path_m) == 100


@pytest.mark.parametrize(
    "key", ["servo_delay_s", "servo_backlash_deg", "friction_cone", "time_step_s", "added_mass_share"]
)
def test_each_of_them_makes_a_difference_to_the_walk(key: str) -> None:
    plan = TrialPlan(gait=make_gait(shipped(), "demo"), duration_s=0.5)
    without = LOOSE.model_copy(update={key: getattr(World(), key)})
    one, other = (
        run_sim_trial(SimTrial(robot=shipped(), plan=plan, failure=None, world=world))
        for world in (LOOSE, without)
    )
    assert not np.array_equal(one.path_m, other.path_m)
