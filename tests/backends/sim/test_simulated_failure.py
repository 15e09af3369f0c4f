"""Each failure breaks the leg physically, whatever the controller sends."""

from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.robot.failure import BROKEN_KINDS, Failure, drawn_failure
from hexctl.robot.loader import load_robot
from hexctl.testing.servo_conformance import move
from hexctl.types import JOINT_KINDS, FloatArray, JointTargets, leg_slice
from tests.robots import ROBOT_NAMES, edited_file, put, shipped
from tests.trials import walk

LEG = 2
JOINTS = leg_slice(LEG)
OTHERS = np.setdiff1d(np.arange(18), np.arange(18)[JOINTS])


def _forces_and_angles(failure: Failure | None, *, ticks: int = 150) -> tuple[FloatArray, FloatArray]:
    """Shake all joints a lot and return torques and angles at each tick, (ticks, 18) each."""
    forces, angles = [], []
    with SimServos(shipped(), failure=failure) as servos:
        for index in range(ticks):
            servos.clock.tick()
            wanted = servos.robot.stance_angles_rad + 0.4 * np.sin(0.2 * index)
            servos.write(JointTargets(wanted, servos.clock.now_s))
            forces.append(servos.compiled.physics.data.actuator_force.copy())
            angles.append(servos.read().joint_positions_rad)
    return np.array(forces), np.array(angles)


def test_a_locked_leg_keeps_its_stance_while_the_others_move() -> None:
    _, angles = _forces_and_angles(Failure(leg=LEG, kind="locked"))
    off = np.abs(angles - shipped().stance_angles_rad)
    assert off[:, JOINTS].max() < 0.07
    assert (off[:, OTHERS].max(axis=0) > 0.25).all()


def test_a_limp_leg_makes_no_torque_and_goes_where_it_is_pushed() -> None:
    forces, angles = _forces_and_angles(Failure(leg=LEG, kind="limp"))
    assert (forces[:, JOINTS] == 0).all()
    assert (np.abs(forces[:, OTHERS]).max(axis=0) > 0.1).all()
    whole, followed = _forces_and_angles(None)
    assert (np.abs(whole[:, JOINTS]).max(axis=0) > 0.1).all()
    swing, whole_swing = np.ptp(angles[:, JOINTS.start]), np.ptp(followed[:, JOINTS.start])
    assert swing < 0.5 * whole_swing, "its coxa does not swing as commanded"


def test_a_weak_legs_torque_is_limited_to_its_fraction() -> None:
    failure = Failure(leg=LEG, kind="weak", torque_fraction=0.2)
    with SimServos(shipped(), failure=failure) as servos:
        servos.clock.tick()
        # So far off that every servo would give all it has.
        servos.write(JointTargets(np.full(18, 3.0), 0.0))
        servos.compiled.physics.step()
        force = np.abs(servos.compiled.physics.data.actuator_force)
    np.testing.assert_allclose(force[JOINTS], 0.2 * 2.5)
    np.testing.assert_allclose(force[OTHERS], 2.5)


@pytest.mark.parametrize("kind", JOINT_KINDS)
@pytest.mark.parametrize("load_kg", [0.0, 0.5])
def test_a_stuck_joint_stays_at_its_angle_under_load_while_its_leg_moves(kind: str, load_kg: float) -> None:
    joint = JOINTS.start + JOINT_KINDS.index(kind)
    angle_rad = float(shipped().stance_angles_rad[joint]) + np.radians(10)
    failure = Failure(leg=LEG, kind="stuck", joint=kind, angle_rad=angle_rad)
    outcome = walk(failure=failure, self_rotation="none", world=World(payload_kg=load_kg), duration_s=5)
    angles = np.degrees(outcome.log["measured_rad"][50:])
    assert np.abs(angles[:, joint] - np.degrees(angle_rad)).max() < 2
    moving = [other for other in range(JOINTS.start, JOINTS.stop) if other != joint]
    assert (np.ptp(angles[:, moving], axis=0) > 5).all()


@pytest.mark.parametrize("torque_nm", [-4.0, 4.0])
def test_a_stuck_joint_stays_where_a_servo_would_have_to_give_way(torque_nm: float) -> None:
    """4 N m is more than any servo of the robot makes."""
    joint = JOINTS.start
    failure = Failure(leg=LEG, kind="stuck", joint="coxa", angle_rad=float(np.radians(10)))
    with SimServos(shipped(), failure=failure) as servos:
        servos.compiled.physics.data.qfrc_applied[6 + joint] = torque_nm
        move(servos, servos.robot.stance_angles_rad, ticks=50)
        assert np.degrees(servos.read().joint_positions_rad[joint]) == pytest.approx(10, abs=2)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_missing_leg_touches_nothing_and_weighs_nothing(name: str) -> None:
    robot = shipped(name)
    outcome = walk(robot=robot, failure=Failure(leg=LEG, kind="missing"), self_rotation="none", duration_s=5)
    contacts = outcome.log["foot_contacts"]
    assert not contacts[:, LEG - 1].any()
    assert contacts[:, [leg for leg in range(6) if leg != LEG - 1]].any(axis=0).all()
    with SimServos(robot, failure=Failure(leg=LEG, kind="missing")) as servos:
        mass = servos.compiled.physics.model.body_mass.sum()
    assert mass == pytest.approx(robot.mass_kg - robot.link_masses_kg.sum(), rel=1e-3)


def test_a_robot_that_is_called_like_its_missing_leg_keeps_the_others(tmp_path: Path) -> None:
    robot = load_robot(edited_file(tmp_path, put("name", "leg3")))
    failure = Failure(leg=3, kind="missing")
    contacts = walk(robot=robot, failure=failure, self_rotation="none", duration_s=3).log["foot_contacts"]
    assert not contacts[:, 2].any()
    assert contacts[:, [0, 1, 3, 4, 5]].any(axis=0).all()
    with SimServos(robot, failure=failure) as servos:
        mass = servos.compiled.physics.model.body_mass.sum()
    assert mass == pytest.approx(robot.mass_kg - robot.link_masses_kg.sum(), rel=1e-3)


@pytest.mark.parametrize("kind", BROKEN_KINDS)
def test_a_failure_changes_its_own_leg_only(kind: str) -> None:
    """The other legs' servos answer a big command with all their torque, as they do in a whole robot."""
    failure = Failure(leg=LEG, kind=kind, angle_rad=0.3)
    with SimServos(shipped(), failure=failure) as servos:
        servos.clock.tick()
        servos.write(JointTargets(np.full(18, 3.0), 0.0))
        servos.compiled.physics.step()
        force = np.abs(servos.compiled.physics.data.actuator_force)
    np.testing.assert_allclose(force[OTHERS], 2.5)


@pytest.mark.parametrize("degrees", [-61, 500])
def test_a_joint_cannot_be_stuck_where_it_cannot_go(degrees: float) -> None:
    failure = Failure(leg=LEG, kind="stuck", joint="coxa", angle_rad=float(np.radians(degrees)))
    with pytest.raises(InputError, match=f"stuck coxa: got {degrees} deg; allowed: -60 to 60 deg"):
        SimServos(shipped(), failure=failure).connect()


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_an_unknown_failure_is_drawn_with_the_seed_and_can_be_simulated(name: str) -> None:
    robot, unknown = load_robot(name), Failure(leg=LEG, kind="unknown")
    drawn = [drawn_failure(robot, unknown, seed) for seed in range(60)]
    assert drawn == [drawn_failure(robot, unknown, seed) for seed in range(60)]
    assert {one.kind for one in drawn if one is not None} == set(BROKEN_KINDS)
    jams = [one for one in drawn if one is not None and one.kind == "stuck"]
    assert {one.joint for one in jams} == set(JOINT_KINDS)
    for jam in jams:
        index = jam.joint_index
        assert robot.joint_lower_rad[index] <= jam.angle_rad <= robot.joint_upper_rad[index]
    for seed in range(3):
        with SimServos(robot, failure=unknown, seed=seed) as servos:
            assert servos.failure == drawn[seed]


def test_a_failure_that_is_told_is_not_drawn() -> None:
    weak = Failure(leg=3, kind="weak", torque_fraction=0.9)
    assert drawn_failure(shipped(), weak, 7) is weak
    assert drawn_failure(shipped(), None, 7) is None


@pytest.mark.slow
def test_a_locked_leg_walks_the_same_whether_the_controller_is_told_or_not() -> None:
    robot, unknown = shipped(), Failure(leg=LEG, kind="unknown")
    seed = next(
        seed
        for seed in range(100)
        if (one := drawn_failure(robot, unknown, seed)) is not None and one.kind == "locked"
    )
    told = walk(duration_s=2.0, failure=Failure(leg=LEG), seed=seed)
    untold = walk(duration_s=2.0, failure=unknown, seed=seed)
    np.testing.assert_array_equal(told.result.path_m, untold.result.path_m)
