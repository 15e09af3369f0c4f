"""From a joint target to the shaft: delay, calibration error, play and a jam, for one robot and for many."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.sim.actuators import ActuatorModel
from hexctl.backends.sim.sensing import LOST_COMMANDS, Losses
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulated_batch import SimBatch
from hexctl.backends.sim.simulated_failure import jammed_angles_rad
from hexctl.backends.sim.simulation_model import FIRST_JOINT, Simulation, make_simulation
from hexctl.backends.sim.world import World, load_world
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure, each_failure
from hexctl.testing.servo_conformance import move
from hexctl.types import FloatArray, JointTargets
from tests.robots import shipped

STANCE = shipped().stance_angles_rad

#: Each joint of a test hears the same targets louder or softer, some the other way round.
GAINS = np.linspace(-1.0, 1.0, 18)

#: Everything between a target and the floor that a world can change.
LOOSE = World(
    servo_delay_s=0.056,
    servo_backlash_deg=1.5,
    servo_damping=1.4,
    rotor_inertia_kg_m2=0.008,
    joint_offset_deg=1.0,
    friction_cone="pyramidal",
    time_step_s=0.004,
    added_mass_share=0.2,
    body_mass_shift_m=(0.01, -0.005, 0.005),
    contact_time_s=0.012,
    slope_deg=1.0,
    joint_stiffness=(1.6, 1.2, 0.7),
    joint_friction_nm=tuple(np.linspace(0.05, 0.3, 18).tolist()),
    tibia_error=(0.02, -0.02, 0.01, 0.0, -0.01, 0.015),
    friction_ratio=0.8,
    state_latency_s=0.028,
    lost_commands=0.1,
)

angles = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=30)


@cache
def _simulation(failure: Failure | None = None) -> Simulation:
    return make_simulation(shipped(), World(), failure)


def _train(
    failure: Failure | None = None, *, offsets_rad: FloatArray | None = None, **world: float
) -> ActuatorModel:
    """The actuator model of a robot that stands in a world."""
    play_rad = np.full(18, math.radians(world.get("servo_backlash_deg", 0.0)))
    simulation = replace(_simulation(failure), world=World.model_validate(world), play_rad=play_rad)
    if offsets_rad is not None:
        simulation = replace(simulation, joint_offsets_rad=offsets_rad)
    return ActuatorModel.at_rest(simulation, STANCE, jammed_angles_rad(shipped(), failure))


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
        _train(servo_backlash_deg=0.1),
        _train(offsets_rad=np.full(18, 0.01)),
        _train(Failure(leg=2, kind="stuck")),
        _train(lost_commands=0.1),
    ],
    ids=["play", "offset", "jam", "loss"],
)
def test_a_train_with_a_flaw_is_not_plain(train: ActuatorModel) -> None:
    assert not train.plain
    assert not train.copies(2).plain


@given(play_deg=st.floats(0.01, 20.0), given_rad=angles)
def test_offset_and_play_come_in_the_order_of_the_gear(play_deg: float, given_rad: list[float]) -> None:
    """A target, read with the servo's error, turns a shaft that is loose, with the hysteresis of a gear."""
    offsets = np.radians(np.linspace(-3.0, 3.0, 18))
    targets = _targets(given_rad)
    shafts = _driven(_train(offsets_rad=offsets, servo_backlash_deg=play_deg), targets)
    read = targets + offsets
    for joint in range(18):
        expected = _loose_gear(
            read[:, joint].tolist(), math.radians(play_deg), STANCE[joint] + offsets[joint]
        )
        np.testing.assert_allclose(shafts[:, joint], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("delay_s", [0.002, 0.02, 0.034])
def test_a_delayed_target_acts_after_so_many_steps_of_the_physics(delay_s: float) -> None:
    """The first torque comes with the step after the delay, whether the servo or the world has it."""
    slow = replace(shipped(), servo=replace(shipped().servo, dead_time_s=delay_s))
    for robot, world in ((slow, World()), (shipped(), World(servo_delay_s=delay_s))):
        with SimServos(robot, world=world) as servos:
            physics = servos.compiled.physics
            servos.write(JointTargets(STANCE + 0.1, 0.0))
            standing, forces = physics.data.actuator_force.copy(), []
            for _ in range(20):
                mujoco.mj_step(physics.model.ptr, physics.data.ptr)
                forces.append(physics.data.actuator_force.copy())
        rises = np.abs(np.diff([standing, *forces], axis=0)).max(axis=-1)
        assert rises.argmax() == round(delay_s / 0.002)


def test_a_jam_does_not_wait_for_the_delay() -> None:
    with SimServos(shipped(), world=World(servo_delay_s=0.06)) as servos:
        for _ in range(3):
            move(servos, STANCE + 0.3, ticks=1)
        servos.change_leg(2, Failure(leg=2, kind="stuck", joint="femur"))
        jam_rad = servos.compiled.physics.data.qpos[FIRST_JOINT + 4]
        for _ in range(10):
            move(servos, STANCE + 0.3, ticks=1)
        assert abs(servos.compiled.physics.data.qpos[FIRST_JOINT + 4] - jam_rad) < 0.01


def test_a_servo_without_power_has_no_back_emf() -> None:
    """A limp leg falls as fast as friction lets it, and the torque of its servos is zero."""
    robot = shipped("lukas")
    with SimServos(robot) as servos:
        servos.write(JointTargets(robot.stance_angles_rad, 0.0))
        servos.clock.tick()
        model = servos.compiled.physics.model
        powered = model.dof_damping[6:].copy(), model.actuator_biasprm.copy()
        servos.disable_torque()
        np.testing.assert_allclose(model.dof_damping[6:], robot.servo.gear_damping_nm_s_per_rad)
        servos.clock.tick()
        torques_nm = servos.read().joint_torques_nm
        assert torques_nm is not None
        assert not torques_nm.any()
        servos.write(JointTargets(robot.stance_angles_rad, 0.0))
        np.testing.assert_array_equal(model.dof_damping[6:], powered[0])
        np.testing.assert_array_equal(model.actuator_biasprm, powered[1])


def test_play_of_the_robot_file_counts_where_the_world_has_none() -> None:
    loose = replace(shipped(), joint_play_rad=np.radians(np.linspace(0.1, 1.8, 18)))
    np.testing.assert_allclose(make_simulation(loose, World()).play_rad, loose.play_rad)
    drawn = make_simulation(loose, World(servo_backlash_deg=(0.5, 0.0, 1.0))).play_rad
    expected = np.where(np.arange(18) % 3 == 1, loose.play_rad, np.tile(np.radians([0.5, 0, 1.0]), 6))
    np.testing.assert_allclose(drawn, expected)


@given(losses=st.lists(st.booleans(), min_size=1, max_size=30))
def test_a_lost_command_leaves_the_servos_at_the_one_before(losses: list[bool]) -> None:
    train = _train(lost_commands=0.5)
    targets = _targets(np.linspace(-1, 1, len(losses)).tolist())
    driven = np.array([train.drive(row, lost) for row, lost in zip(targets, losses, strict=True)])
    heard: list[FloatArray] = []
    for row, lost in zip(targets, losses, strict=True):
        heard.append((heard[-1] if heard else STANCE) if lost else row)
    np.testing.assert_array_equal(driven, heard)


def test_as_many_commands_are_lost_as_the_world_says_the_same_ones_every_time() -> None:
    def drawn(share: float, seed: int) -> list[bool]:
        loss, lost = Losses(share, LOST_COMMANDS, seed), []
        for _ in range(4000):
            loss.draw()
            lost.append(loss.lost)
        return lost

    assert np.mean(drawn(0.1, 0)) == pytest.approx(0.1, abs=0.02)
    assert drawn(0.1, 0) == drawn(0.1, 0)
    assert drawn(0.1, 0) != drawn(0.1, 1)
    assert not any(drawn(0.0, 0))


@pytest.mark.parametrize("latency_s", [0.013, 0.05])
def test_a_state_is_as_old_as_the_latency(latency_s: float) -> None:
    """Its joints are those of as many physics steps ago, and it says its age."""
    steps = round(latency_s / 0.002)
    course: list[FloatArray] = []
    with (
        SimServos(shipped(), world=World(state_latency_s=latency_s)) as late,
        SimServos(shipped()) as twin,
    ):
        for servos in (late, twin):
            servos.write(JointTargets(STANCE + 0.2, 0.0))
        course.append(twin.compiled.physics.data.qpos.copy())
        for _ in range(10):
            late.clock.tick()
            for _ in range(10):
                twin.compiled.physics.step()
                course.append(twin.compiled.physics.data.qpos.copy())
            state = late.read()
            then = course[max(0, len(course) - 1 - steps)]
            np.testing.assert_array_equal(state.joint_positions_rad, then[FIRST_JOINT:])
            np.testing.assert_array_equal(state.base_position_world, then[:3])
            assert state.age_s == pytest.approx(0.002 * steps)
            assert state.stamp_s == pytest.approx(late.clock.now_s - 0.002 * steps)


def test_a_batch_that_starts_amid_late_states_goes_on_with_them() -> None:
    with SimServos(shipped(), world=World(state_latency_s=0.05, lost_commands=0.3)) as servos:
        for index in range(6):
            move(servos, STANCE + 0.02 * index, ticks=1)
        batch = SimBatch(servos, 3)
        for index in range(12):
            target_rad = STANCE + 0.02 * (6 + index)
            batch.write(np.tile(target_rad, (3, 1)))
            batch.tick()
            servos.write(JointTargets(target_rad, servos.clock.now_s))
            servos.clock.tick()
            alone, together = servos.read(), batch.read()
            np.testing.assert_array_equal(together.joint_positions_rad[1], alone.joint_positions_rad)
            assert (together.stamp_s, together.age_s) == (alone.stamp_s, alone.age_s)


@pytest.mark.parametrize(
    ("world", "failure"),
    [
        (load_world("real:3"), None),
        (LOOSE, Failure(leg=3)),
        (LOOSE, Failure(leg=3, kind="stuck", angle_rad=0.2)),
    ],
)
def test_a_batch_with_everything_loose_equals_its_single_trials(
    world: World, failure: Failure | None
) -> None:
    legs = (failure.leg,) if failure else ()
    trials = [
        SimTrial(
            robot=shipped(),
            plan=TrialPlan(
                gait=make_gait(shipped(), code, failed_legs=legs),
                duration_s=0.6,
                failures=each_failure(failure),
                self_rotation="none",
            ),
            failures=failure,
            world=world,
            seed=5,
            facing_rad=0.7,
        )
        for code in ("1", "57")
    ]
    for made, alone in zip(run_sim_trials(trials), map(run_sim_trial, trials), strict=True):
        assert made.to_dict() == alone.to_dict()
        assert np.array_equal(made.path_m, alone.path_m)
        assert len(made.path_m) == 30
