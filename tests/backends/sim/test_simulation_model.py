"""Masses, joints, friction and torques of a robot in the compiled model, against MuJoCo's own quantities."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulated_batch import SimBatch
from hexctl.backends.sim.simulated_failure import FIRST_SPEED
from hexctl.backends.sim.simulation_model import FIRST_JOINT, make_simulation
from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.identify.bench_run import BenchRun
from hexctl.identify.parameters import ServoValues
from hexctl.robot.failure import Failure, FailureEvent
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.testing.servo_conformance import move
from hexctl.types import FloatArray, JointTargets
from tests.robots import shipped
from tests.trials import gait_of

COM_M = (0.012, -0.004, 0.017)
INERTIA = (0.004, 0.006, 0.007)
STILL = World()


def _with(**changes: Any) -> Robot:
    return replace(shipped(), **changes)


def _trunk(physics: Any, robot: Robot) -> tuple[float, Any, Any]:
    """Mass, centre of mass and moments of inertia of the trunk about the body frame's axes."""
    model = physics.model
    index = model.name2id(f"{robot.name}/trunk", "body")
    import mujoco

    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[index])
    axes = turn.reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[index]) @ axes.T
    return float(model.body_mass[index]), model.body_ipos[index].copy(), inertia


def test_the_trunk_has_its_centre_of_mass_and_inertia() -> None:
    robot = _with(body=replace(shipped().body, mass_kg=1.5, com_m=COM_M, inertia_kg_m2=INERTIA))
    mass_kg, com_m, inertia = _trunk(make_simulation(robot, STILL).physics, robot)
    assert mass_kg == pytest.approx(1.5)
    np.testing.assert_allclose(com_m, COM_M, atol=1e-12)
    np.testing.assert_allclose(inertia, np.diag(INERTIA), atol=1e-12)


def test_the_links_have_their_centres_of_mass() -> None:
    coms = np.array([[0.02, 0.005], [0.03, -0.002], [0.04, 0.01]])
    robot = _with(link_coms_m=coms)
    model, plain = (make_simulation(one, STILL).physics.model for one in (robot, shipped()))
    for kind, com in zip(("coxa", "femur", "tibia"), coms, strict=True):
        body = model.name2id(f"ant/leg4/{kind}", "body")
        np.testing.assert_allclose(model.body_ipos[body], [com[0], 0, com[1]], atol=1e-12)
        assert model.body_mass[body] == pytest.approx(plain.body_mass[body])
    assert model.body_mass.sum() == pytest.approx(robot.mass_kg)


def test_a_worlds_load_comes_on_top_of_the_robots_own_centre_of_mass() -> None:
    """The world shifts the mass from where the robot file has it, and scales it with its inertia."""
    robot = _with(body=replace(shipped().body, mass_kg=1.5, com_m=COM_M, inertia_kg_m2=INERTIA))
    world = World(added_mass_share=0.2, body_mass_shift_m=(0.01, 0.0, -0.005))
    mass_kg, com_m, inertia = _trunk(make_simulation(robot, world).physics, robot)
    assert mass_kg == pytest.approx(1.5 + 0.2 * robot.mass_kg)
    np.testing.assert_allclose(com_m, np.add(COM_M, world.body_mass_shift_m), atol=1e-12)
    np.testing.assert_allclose(inertia, np.diag(INERTIA) * mass_kg / 1.5, atol=1e-9)


def _floating(robot: Robot, failure: Failure | None = None) -> Any:
    """The physics of a robot without weight, far above the floor, and without servos' springs."""
    physics = make_simulation(robot, STILL, failure).physics
    physics.model.opt.gravity[:] = 0
    physics.data.qpos[2] = 5
    return physics


def _loose(robot: Robot) -> Any:
    physics = _floating(robot)
    physics.model.actuator_gainprm[:] = 0
    physics.model.actuator_biasprm[:] = 0
    return physics


@pytest.mark.parametrize(("load_nm", "moves"), [(0.08, False), (0.12, True)])
def test_a_joint_turns_only_under_more_than_its_dry_friction(load_nm: float, moves: bool) -> None:
    physics = _loose(_with(joint_dry_friction_nm=np.full(18, 0.1)))
    before = physics.data.qpos[FIRST_JOINT].copy()
    physics.data.qfrc_applied[6] = load_nm
    physics.step(500)
    turned_deg = abs(math.degrees(physics.data.qpos[FIRST_JOINT] - before))
    assert turned_deg > 5 if moves else turned_deg < 0.1


NO_LOAD_RAD_S = 8.0


@pytest.mark.parametrize("share", [0.0, 0.75])
def test_torque_falls_on_a_line_from_stall_to_the_speed_without_load(share: float) -> None:
    """A servo at full voltage gives stall * (1 - speed / no-load speed), told by what its joint feels."""
    robot = _with(joint_no_load_speed_rad_s=np.full(18, NO_LOAD_RAD_S))
    torques = []
    for one in (robot, shipped()):
        physics = _floating(one)
        physics.data.qvel[6] = share * NO_LOAD_RAD_S
        physics.data.ctrl[0] = 100.0  # so far off that the servo gives all it has
        physics.forward()
        torques.append(physics.data.qfrc_actuator[6] + physics.data.qfrc_passive[6])
    assert torques[0] - torques[1] == pytest.approx(-share * 2.5)
    gear = physics.data.qfrc_passive[6]
    assert torques[0] - gear == pytest.approx(2.5 * (1 - share))


def test_a_limp_leg_keeps_its_friction_and_loses_its_back_emf() -> None:
    robot = _with(joint_no_load_speed_rad_s=np.full(18, 8.0), joint_dry_friction_nm=np.full(18, 0.1))
    whole = _floating(robot).model
    limp = _floating(robot, Failure(leg=1, kind="limp")).model
    weak = _floating(robot, Failure(leg=1, kind="weak", torque_fraction=0.4)).model
    np.testing.assert_allclose(whole.dof_damping[6:9], 0.02 + 2.5 / 8)
    np.testing.assert_allclose(limp.dof_damping[6:9], 0.02)
    np.testing.assert_allclose(weak.dof_damping[6:9], 0.02 + 0.4 * 2.5 / 8)
    np.testing.assert_array_equal(limp.dof_damping[9:], whole.dof_damping[9:])
    np.testing.assert_array_equal(limp.dof_frictionloss, whole.dof_frictionloss)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (1.5, np.full(18, 1.5)),
        ((3.0, 2.0, 0.5), np.tile([3.0, 2.0, 0.5], 6)),
        (tuple(np.linspace(0.5, 2.0, 18).tolist()), np.linspace(0.5, 2.0, 18)),
    ],
)
def test_a_world_scales_the_stiffness_of_each_joint(given: Any, expected: FloatArray) -> None:
    robot = _with(joint_stiffness_nm_per_rad=np.tile([30.0, 20.0, 10.0], 6))
    model = make_simulation(robot, World(joint_stiffness=given, servo_stiffness=2.0)).physics.model
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], np.tile([60.0, 40.0, 20.0], 6) * expected)
    np.testing.assert_allclose(model.actuator_biasprm[:, 1], -np.tile([60.0, 40.0, 20.0], 6) * expected)


def test_a_worlds_friction_replaces_the_robots_own() -> None:
    robot = _with(joint_dry_friction_nm=np.full(18, 0.5))
    for world, expected in (
        (World(), 0.5),
        (World(joint_friction_nm=0.0), 0.0),
        (World(joint_friction_nm=0.2), 0.2),
    ):
        model = make_simulation(robot, world).physics.model
        np.testing.assert_array_equal(model.dof_frictionloss, [0.0] * 6 + [expected] * 18)


def test_longer_tibias_put_their_feet_further_out_and_nothing_into_the_floor() -> None:
    errors = (0.1, 0.0, -0.1, 0.0, 0.0, 0.0)
    long, plain = (make_simulation(shipped(), World(tibia_error=error)).physics for error in (errors, 0.0))
    assert long.data.ncon == 0 or long.data.contact.dist.min() > -1e-9
    for leg, error in enumerate(errors, start=1):
        foot, knee = (
            long.named.data.geom_xpos[f"ant/leg{leg}/foot"],
            long.named.data.xpos[f"ant/leg{leg}/tibia"],
        )
        was = np.linalg.norm(
            plain.named.data.geom_xpos[f"ant/leg{leg}/foot"] - plain.named.data.xpos[f"ant/leg{leg}/tibia"]
        )
        assert np.linalg.norm(foot - knee) == pytest.approx((1 + error) * was)


@pytest.mark.parametrize(
    ("cone", "floor"),
    [
        ("elliptic", {}),
        ("pyramidal", {"slope_deg": 10, "slope_direction_deg": 30}),
        ("elliptic", {"roughness_m": 0.004}),
    ],
)
def test_a_grain_has_its_friction_along_the_worlds_axes_wherever_the_robot_faces(
    cone: Any, floor: dict[str, Any]
) -> None:
    """Every contact of a foot has its first tangential axis along y, and the friction of that axis first."""
    world = World(friction=0.5, friction_ratio=1.6, friction_cone=cone, **floor)
    for facing_rad in (0.0, 2.0):
        physics = make_simulation(shipped(), world, facing_rad=facing_rad).physics
        physics.step(60)
        feet = [contact for contact in physics.data.ptr.contact if contact.dist < 0]
        assert len(feet) >= 2
        for contact in feet:
            np.testing.assert_allclose(contact.friction, [0.8, 0.5, 0.005, 0.0001, 0.0001])
            assert contact.frame[4] > 0.95, "its first tangential axis is the y axis"
            assert contact.dim == 3


def test_a_robot_slides_across_the_grain_and_not_along_it() -> None:
    """On a slope between the two frictions it stays with the slope along y and slips with it along x."""
    slipped = []
    for direction_deg in (0, 90):
        world = World(friction=0.25, friction_ratio=3.0, slope_deg=22, slope_direction_deg=direction_deg)
        with SimServos(shipped(), world=world) as servos:
            before = servos.read().base_position_world
            move(servos, shipped().stance_angles_rad, ticks=50)
            after = servos.read().base_position_world
        assert before is not None
        assert after is not None
        slipped.append(float(np.linalg.norm((after - before)[:2])))
    assert slipped[0] > 0.3
    assert slipped[1] < 0.05


# Torques of the actuators.

JOINTS = slice(FIRST_SPEED, FIRST_SPEED + 18)


class Metered(SimServos):
    """A simulation that is stepped one by one, with MuJoCo's forces and power of each step."""

    def connect(self) -> None:
        super().connect()
        self.forces_nm: list[FloatArray] = []
        self.work_j: list[FloatArray] = []

    def _step(self) -> None:
        physics, forces, work = self.compiled.physics, [], []
        back_emf = self.robot.back_emf_nm_s_per_rad
        for _ in range(self.world.steps_per_tick):
            physics.step()
            velocity = np.array(physics.data.qvel[JOINTS])
            force = np.array(physics.data.qfrc_actuator[JOINTS])
            forces.append(force)
            work.append((force - back_emf * velocity) * velocity * self.world.time_step_s)
        self.forces_nm.append(np.mean(forces, axis=0))
        self.work_j.append(np.sum(work, axis=0))


@pytest.mark.parametrize("name", ["ant", "phantomx"])
def test_energy_is_the_work_of_mujocos_forces(name: str) -> None:
    with Metered(shipped(name)) as servos:
        plan = TrialPlan(gait=gait_of(servos.robot, "tripod"), duration_s=2.0)
        result = run_trial(Guard(servos), plan, soft_stop=False)
        # Each period of each joint is counted where it is positive; the walk's first tick begins the count.
        work_j = np.array(servos.work_j)[-99:]
    assert result.energy_j == pytest.approx(np.maximum(work_j, 0).sum(), rel=0.04)
    weight_n = 9.81 * servos.robot.mass_kg
    assert result.energy_j is not None
    assert result.distance_m is not None
    cost = result.energy_j / (weight_n * result.distance_m)
    assert result.cost_of_transport == pytest.approx(cost)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["limp", "missing"])
def test_a_leg_without_torque_costs_nothing(kind: str) -> None:
    failure, log = Failure(leg=5, kind=kind), TickLog()
    with SimServos(shipped(), failures=failure) as servos:
        plan = TrialPlan(
            gait=gait_of(servos.robot), failures=(failure,), self_rotation="none", duration_s=1.0
        )
        run_trial(Guard(servos), plan, recorders=(log,))
    torques_nm = log["joint_torques_nm"]
    assert (torques_nm[:, 12:15] == 0).all()
    assert (torques_nm[:, :12] != 0).any(axis=0).all()


def test_the_servo_of_a_stuck_joint_pushes_against_the_jam() -> None:
    """As stiff as it is and no stronger, whatever the jam itself takes."""
    with SimServos(shipped(), failures=parse_kind(2, "stuck:femur:30")) as servos:
        robot = servos.robot
        for off_rad in (0.02, 1.0):
            targets_rad = robot.stance_angles_rad.copy()
            targets_rad[4] = np.radians(30.0) + off_rad
            move(servos, targets_rad, ticks=20)
            servos.clock.tick()
            state = servos.read()
            assert state.joint_torques_nm is not None
            pushed_nm = robot.stiffness_nm_per_rad[4] * (targets_rad[4] - state.joint_positions_rad[4])
            limit_nm = robot.joint_max_torque_nm[4]
            assert state.joint_torques_nm[4] == pytest.approx(min(pushed_nm, limit_nm))
            assert (pushed_nm > limit_nm) == (off_rad == 1.0)


# Friction that grows with the load.

DRY_NM, STALL_NM, STIFFNESS = 0.02, 2.0, 4.0


def rubbing(share: float) -> Robot:
    robot = shipped("lukas")
    return replace(robot, servo=replace(robot.servo, load_friction=share))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_a_motor_that_slowly_raises_and_lowers_a_mass_balances_it_and_its_gears(share: float) -> None:
    time_s = np.arange(0.0, 20.0, 0.02)
    goal_rad = 0.9 - np.abs(0.9 - 0.09 * time_s)
    run = BenchRun("slow", 0.6, 0.12, 0.0, 1.0, time_s, goal_rad, 0 * time_s, time_s >= 0)
    values = ServoValues(
        stiffness_nm_per_rad=STIFFNESS,
        damping_nm_s_per_rad=1e-4,
        rotor_inertia_kg_m2=0.005,
        dry_friction_nm=DRY_NM,
        load_friction=share,
        gear_damping_nm_s_per_rad=0.05,
        max_torque_nm=STALL_NM,
        no_load_speed_rad_s=1e6,
        dead_time_s=0.0,
    )
    angles_rad = run.errors_rad(values)
    for at_s, way in ((7.0, 1), (9.0, 1), (13.0, -1), (15.0, -1)):
        row = int(at_s / 0.02)
        motor_nm = STIFFNESS * (goal_rad[row] - angles_rad[row])
        lost_nm = DRY_NM + share * motor_nm * (1 + motor_nm / STALL_NM) / 2
        load_nm = 0.6 * 9.81 * 0.12 * np.sin(angles_rad[row])
        assert motor_nm - way * lost_nm == pytest.approx(load_nm, abs=0.012)


def test_servos_without_power_keep_the_dry_friction() -> None:
    with SimServos(rubbing(0.4)) as servos:
        move(servos, servos.robot.stance_angles_rad + 0.05, ticks=20)
        model, dry_nm = servos.compiled.physics.model, servos.robot.dry_friction_nm
        assert (model.dof_frictionloss[6:] > dry_nm).all()
        servos.disable_torque()
        servos.clock.tick()
        np.testing.assert_array_equal(model.dof_frictionloss[6:], dry_nm)


def test_a_batch_of_worlds_with_events_equals_its_single_robots() -> None:
    """Copies that are told different things rub differently, and a leg that fails changes no friction."""
    event = FailureEvent(at_s=0.1, leg=2, failure=Failure(leg=2, kind="missing"))

    def begun(world: str, events: tuple[FailureEvent, ...]) -> SimServos:
        servos = SimServos(rubbing(0.5), world=world, events=events)
        servos.connect()
        move(servos, servos.robot.stance_angles_rad + 0.05, ticks=5)
        servos.walk_begins()
        return servos

    kinds = [("flat", (event,)), ("slippery", ())]
    stance_rad, waves = shipped("lukas").stance_angles_rad, (0.05, 0.1)
    batch = SimBatch([begun(*kind) for kind in kinds], [2, 2])
    alone = [(begun(*kind), size) for kind in kinds for size in waves]
    for tick in range(12):
        wave = np.sin(0.6 * tick)
        batch.write(np.array([stance_rad + size * wave for _ in kinds for size in waves]))
        batch.tick()
        for servos, size in alone:
            servos.write(JointTargets(stance_rad + size * wave, 0.0))
            servos.clock.tick()
    states = [servos.read().joint_positions_rad for servos, _ in alone]
    np.testing.assert_array_equal(batch.read().joint_positions_rad, states)
