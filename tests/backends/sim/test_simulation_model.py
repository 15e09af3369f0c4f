"""Masses and joints of a robot file in the compiled model, against MuJoCo told otherwise."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulation_model import FIRST_JOINT, make_simulation
from hexctl.backends.sim.world import World
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.testing.servo_conformance import move
from hexctl.types import FloatArray
from tests.robots import shipped

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


def _oracle(mass_kg: float, com_m: Any, inertia: Any) -> Any:
    """A free body whose inertia MuJoCo is told outright."""
    import mujoco

    com, moments = (" ".join(map(str, values)) for values in (com_m, inertia))
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body><freejoint/><inertial pos='{com}' mass='{mass_kg}' "
        f"diaginertia='{moments}'/><geom size='0.01'/></body></worldbody></mujoco>"
    )


def test_the_trunk_has_its_centre_of_mass_and_inertia() -> None:
    robot = _with(body=replace(shipped().body, mass_kg=1.5, com_m=COM_M, inertia_kg_m2=INERTIA))
    mass_kg, com_m, inertia = _trunk(make_simulation(robot, STILL).physics, robot)
    oracle = _oracle(1.5, COM_M, INERTIA)
    assert mass_kg == pytest.approx(oracle.body_mass[1])
    np.testing.assert_allclose(com_m, oracle.body_ipos[1], atol=1e-12)
    np.testing.assert_allclose(inertia, np.diag(INERTIA), atol=1e-12)
    np.testing.assert_allclose(sorted(oracle.body_inertia[1]), sorted(INERTIA))


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
