"""Failures break a leg physically, whatever the controller sends, from the beginning or on the way."""

from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import BROKEN_KINDS, Failure, FailureEvent, drawn_failure
from hexctl.robot.failure_grammar import parse_failure_event, parse_healing
from hexctl.robot.loader import load_robot
from hexctl.types import JOINT_KINDS, FloatArray, JointTargets, leg_slice
from tests.robots import edited_file, put, shipped
from tests.trials import walk

LEG = 2
JOINTS = leg_slice(LEG)
OTHERS = np.setdiff1d(np.arange(18), np.arange(18)[JOINTS])


def _shaken(
    failure: Failure | None = None, *events: FailureEvent, swing_rad: float = 0.3, ticks: int = 140
) -> tuple[FloatArray, FloatArray]:
    """Move all joints of a walking robot; torques and angles at each tick, (ticks, 18) each."""
    forces, angles = [], []
    with SimServos(shipped(), failures=failure, events=events) as servos:
        servos.walk_begins()
        for index in range(ticks):
            servos.clock.tick()
            wanted = servos.robot.stance_angles_rad + swing_rad * np.sin(0.2 * index)
            servos.write(JointTargets(wanted, servos.clock.now_s))
            forces.append(servos.compiled.physics.data.actuator_force.copy())
            angles.append(servos.read().joint_positions_rad)
    return np.array(forces), np.array(angles)


def test_a_locked_leg_keeps_its_stance_while_the_others_move() -> None:
    _, angles = _shaken(Failure(leg=LEG, kind="locked"), swing_rad=0.4)
    off = np.abs(angles - shipped().stance_angles_rad)
    assert off[:, JOINTS].max() < 0.07
    assert (off[:, OTHERS].max(axis=0) > 0.25).all()


def test_a_limp_leg_makes_no_torque_and_goes_where_it_is_pushed() -> None:
    forces, angles = _shaken(Failure(leg=LEG, kind="limp"), swing_rad=0.4)
    assert (forces[:, JOINTS] == 0).all()
    assert (np.abs(forces[:, OTHERS]).max(axis=0) > 0.1).all()
    whole, followed = _shaken(swing_rad=0.4)
    assert (np.abs(whole[:, JOINTS]).max(axis=0) > 0.1).all()
    swing, whole_swing = np.ptp(angles[:, JOINTS.start]), np.ptp(followed[:, JOINTS.start])
    assert swing < 0.5 * whole_swing, "its coxa does not swing as commanded"


def test_a_weak_legs_torque_is_limited_to_its_fraction() -> None:
    failure = Failure(leg=LEG, kind="weak", torque_fraction=0.2)
    with SimServos(shipped(), failures=failure) as servos:
        servos.clock.tick()
        # So far off that every servo would give all it has.
        servos.write(JointTargets(np.full(18, 3.0), 0.0))
        servos.compiled.physics.step()
        force = np.abs(servos.compiled.physics.data.actuator_force)
    np.testing.assert_allclose(force[JOINTS], 0.2 * 2.5)
    np.testing.assert_allclose(force[OTHERS], 2.5)


@pytest.mark.parametrize("kind", JOINT_KINDS)
def test_a_stuck_joint_stays_at_its_angle_under_load_while_its_leg_moves(kind: str) -> None:
    joint = JOINTS.start + JOINT_KINDS.index(kind)
    angle_rad = float(shipped().stance_angles_rad[joint]) + np.radians(10)
    failure = Failure(leg=LEG, kind="stuck", joint=kind, angle_rad=angle_rad)
    outcome = walk(failure=failure, self_rotation="none", world=World(payload_kg=0.5), duration_s=3)
    angles = np.degrees(outcome.log["measured_rad"][50:])
    assert np.abs(angles[:, joint] - np.degrees(angle_rad)).max() < 2
    moving = [other for other in range(JOINTS.start, JOINTS.stop) if other != joint]
    assert (np.ptp(angles[:, moving], axis=0) > 5).all()


@pytest.mark.slow
def test_a_missing_leg_touches_nothing_and_weighs_nothing(tmp_path: Path) -> None:
    """Of a robot that is called like its missing leg, too."""
    robot = load_robot(edited_file(tmp_path, put("name", "leg2")))
    failure = Failure(leg=LEG, kind="missing")
    contacts = walk(robot=robot, failure=failure, self_rotation="none", duration_s=3).log["foot_contacts"]
    assert not contacts[:, LEG - 1].any()
    assert contacts[:, [leg for leg in range(6) if leg != LEG - 1]].any(axis=0).all()
    with SimServos(robot, failures=failure) as servos:
        mass = servos.compiled.physics.model.body_mass.sum()
    assert mass == pytest.approx(robot.mass_kg - robot.link_masses_kg.sum(), rel=1e-3)


@pytest.mark.parametrize("degrees", [-61, 61])
def test_a_joint_cannot_be_stuck_where_it_cannot_go(degrees: float) -> None:
    failure = Failure(leg=LEG, kind="stuck", joint="coxa", angle_rad=float(np.radians(degrees)))
    with pytest.raises(InputError, match=f"stuck coxa: got {degrees} deg"):
        SimServos(shipped(), failures=failure).connect()


def test_an_unknown_failure_is_drawn_with_the_seed_and_can_be_simulated() -> None:
    robot, unknown = shipped("pexod"), Failure(leg=LEG, kind="unknown")
    drawn = [drawn_failure(robot, unknown, seed) for seed in range(60)]
    assert drawn == [drawn_failure(robot, unknown, seed) for seed in range(60)]
    assert {one.kind for one in drawn} == set(BROKEN_KINDS)
    jams = [one for one in drawn if one.kind == "stuck"]
    assert {one.joint for one in jams} == set(JOINT_KINDS)
    for jam in jams:
        index = jam.joint_index
        assert robot.joint_lower_rad[index] <= jam.angle_rad <= robot.joint_upper_rad[index]
    for seed in range(3):
        with SimServos(robot, failures=unknown, seed=seed) as servos:
            assert servos.failures == (drawn[seed],)

    weak = Failure(leg=3, kind="weak", torque_fraction=0.9)
    assert drawn_failure(robot, weak, 7) is weak


# Failures that come and go while a simulation runs, alone and in a batch.


def _angles(*events: FailureEvent, ticks: int = 140) -> FloatArray:
    return _shaken(None, *events, ticks=ticks)[1]


def _event(text: str) -> FailureEvent:
    return parse_failure_event(text)


def test_before_it_connects_it_knows_with_which_failures_it_begins() -> None:
    first, second = Failure(leg=LEG), Failure(leg=1, kind="limp")
    servos = SimServos(shipped(), failures=(first, second))
    assert servos.failures == (second, first)
    assert servos.true_pose is None


def test_until_it_comes_a_failure_changes_nothing() -> None:
    whole, broken = _angles(ticks=60), _angles(_event(f"{LEG}:limp@1"), ticks=60)
    assert (whole[:51] == broken[:51]).all()
    assert (whole[51] != broken[51]).any(), "the period that begins at 1 s ends in the tick after"


def test_a_leg_locks_where_it_is_and_moves_again_once_healed() -> None:
    angles = _angles(_event(f"{LEG}:locked@1.3"), parse_healing(f"{LEG}@3"), ticks=200)
    held = angles[80:150, JOINTS]
    assert np.ptp(held, axis=0).max() < 0.1
    assert (np.abs(held.mean(axis=0) - angles[65, JOINTS]) < 0.15).all(), "where it was"
    assert (np.abs(held.mean(axis=0) - shipped().stance_angles_rad[JOINTS]) > 0.1).any(), "not the stance"
    assert np.ptp(angles[160:, JOINTS], axis=0).min() > 0.25


@pytest.mark.parametrize("joint", ["coxa", "femur", "tibia"])
def test_one_joint_sticks_where_it_is(joint: str) -> None:
    angles = _angles(_event(f"{LEG}:stuck:{joint}@1.3"))
    index = Failure(leg=LEG, kind="stuck", joint=joint).joint_index
    spread = np.ptp(angles[80:], axis=0)
    assert spread[index] < 0.02
    assert (np.delete(spread, index) > 0.2).all()


def test_one_joint_goes_limp() -> None:
    with SimServos(shipped()) as servos:
        servos.change_leg(LEG, Failure(leg=LEG, kind="limp", joint="femur"))
        for index in range(30):
            servos.clock.tick()
            servos.write(JointTargets(servos.robot.stance_angles_rad + 0.01 * index, servos.clock.now_s))
        forces = servos.compiled.physics.data.actuator_force
        dead = Failure(leg=LEG, kind="limp", joint="femur").joint_index
        assert forces[dead] == 0
        assert (np.abs(np.delete(forces, dead)) > 1e-3).all()
        assert [str(failure) for failure in servos.failures] == ["limp:femur"]


@pytest.mark.parametrize("ratio", [1.0, 0.8])
def test_a_healed_robot_is_the_robot_that_it_was(ratio: float) -> None:
    names = ["actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "dof_damping", "geom_conaffinity"]
    names += ["pair_margin", "body_mass", "body_inertia", "body_subtreemass", "dof_invweight0"]
    world = SimServos(shipped()).world.model_copy(update={"friction_ratio": ratio})
    with SimServos(shipped(), world=world) as servos:
        model = servos.compiled.physics.model.ptr
        before = {name: getattr(model, name).copy() for name in names}
        for kind in ("locked", "limp", "missing", "weak:0.2", "stuck:tibia", "limp:femur"):
            servos.change_leg(LEG, _event(f"{LEG}:{kind}@0").failure)
            servos.change_leg(5, Failure(leg=5, kind="limp"))
            servos.change_leg(LEG, None)
            assert servos.failures == (Failure(leg=5, kind="limp"),)
            servos.change_leg(5, None)
            for name in names:
                np.testing.assert_array_equal(getattr(model, name), before[name], err_msg=f"{name} {kind}")


@pytest.mark.parametrize("ratio", [1.0, 0.8])
def test_a_leg_that_is_lost_no_longer_touches_the_floor(ratio: float) -> None:
    world = SimServos(shipped()).world.model_copy(update={"friction_ratio": ratio})
    with SimServos(shipped(), world=world) as servos:
        stance = servos.robot.stance_angles_rad
        for index in range(60):
            if index == 30:
                assert servos.read().foot_contacts is not None
                assert servos.read().foot_contacts.all()  # type: ignore[union-attr]
                servos.change_leg(LEG, Failure(leg=LEG, kind="missing"))
            servos.clock.tick()
            servos.write(JointTargets(stance, servos.clock.now_s))
        contacts = servos.read().foot_contacts
        assert contacts is not None
        assert contacts.tolist() == [leg != LEG for leg in range(1, 7)]


def test_torque_comes_back_after_a_leg_fails_while_the_servos_are_off() -> None:
    with SimServos(shipped()) as servos:
        servos.clock.tick()
        servos.disable_torque()
        servos.change_leg(LEG, Failure(leg=LEG, kind="limp"))
        servos.clock.tick()
        servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
        gains = servos.compiled.physics.model.actuator_gainprm[:, 0]
        assert (gains[JOINTS] == 0).all()
        assert (np.delete(gains, np.arange(18)[JOINTS]) > 0).all()
        servos.disable_torque()
        servos.change_leg(LEG, None)
        assert (gains == 0).all(), "they stay off when the leg heals"


KINDS = ("locked", "limp", "missing", "stuck:femur", "limp:tibia", "weak:0.2")


@pytest.mark.slow
def test_walks_whose_legs_fail_together_equal_each_alone() -> None:
    """Each in its own world, with its own failure and time; losses, delays and noise of the worlds too."""
    robot = shipped()
    plan = TrialPlan(gait=make_gait(robot, "tripod"), hold="line", duration_s=2.2)
    trials = [
        SimTrial(
            robot=robot,
            plan=plan,
            failures=None,
            world="flat" if leg % 2 else f"real:{leg}",
            events=[_event(f"{leg}:{kind}@{1 + 0.1 * leg}"), parse_healing(f"{leg}@2")],
        )
        for leg, kind in enumerate(KINDS, start=1)
    ]
    together = run_sim_trials([*trials, trials[0]])
    assert together[0] == together[-1], "two of one start too"
    for trial, result in zip(trials, together[:-1], strict=True):
        assert result == run_sim_trial(trial)
    whole = run_sim_trial(SimTrial(robot=robot, plan=plan, failures=None, world="flat"))
    assert all(result.path_m[-1, 0] != whole.path_m[-1, 0] for result in together[:-1:2])


def test_a_world_file_has_failures_to_come(tmp_path: Path) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text('failures: ["2:limp@0.3"]\nhealings: ["2@0.6"]\n', encoding="utf-8")
    seen = []
    with SimServos(shipped(), world=path) as servos:
        servos.walk_begins()
        for _ in range(50):
            servos.clock.tick()
            seen.append(len(servos.failures))
    assert seen == [0] * 16 + [1] * 15 + [0] * 19


@pytest.mark.parametrize("failure", [Failure(leg=5), Failure(leg=LEG, kind="unknown")])
def test_a_failure_that_no_leg_can_have_is_refused(failure: Failure) -> None:
    with SimServos(shipped()) as servos:
        with pytest.raises(InputError, match="failure: "):
            servos.change_leg(LEG, failure)
        assert servos.failures == ()
