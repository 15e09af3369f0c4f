"""Legs fail and heal while a simulation runs, alone and in a batch."""

from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import load_world
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure, FailureEvent
from hexctl.robot.failure_grammar import parse_failure_event, parse_healing
from hexctl.types import FloatArray, JointTargets, leg_slice
from tests.robots import shipped

LEG = 2
JOINTS = leg_slice(LEG)


def _angles(*events: FailureEvent, ticks: int = 200) -> FloatArray:
    """Joint angles, (ticks, 18), of a robot that moves all joints, and fails on the way."""
    angles = []
    with SimServos(shipped(), events=events) as servos:
        servos.walk_begins()
        for index in range(ticks):
            servos.clock.tick()
            wanted = servos.robot.stance_angles_rad + 0.3 * np.sin(0.2 * index)
            servos.write(JointTargets(wanted, servos.clock.now_s))
            angles.append(servos.read().joint_positions_rad)
    return np.array(angles)


def _event(text: str) -> FailureEvent:
    return parse_failure_event(text)


def test_before_it_connects_it_knows_with_which_failures_it_begins() -> None:
    first, second = Failure(leg=LEG), Failure(leg=1, kind="limp")
    servos = SimServos(shipped(), failure=first, further_failures=(second,))
    assert servos.failures == (second, first)
    assert servos.true_pose is None
    with servos:
        assert servos.failures == (second, first)


def test_until_it_comes_a_failure_changes_nothing() -> None:
    whole, broken = _angles(), _angles(_event(f"{LEG}:limp@2"))
    assert (whole[:101] == broken[:101]).all()
    assert (whole[101] != broken[101]).any(), "the period that begins at 2 s ends in the tick after"


def test_a_leg_locks_where_it_is_and_moves_again_once_healed() -> None:
    angles = _angles(_event(f"{LEG}:locked@1.3"), parse_healing(f"{LEG}@3"))
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


@pytest.mark.parametrize("kind", ["locked", "limp", "missing", "weak:0.2", "stuck:tibia", "limp:femur"])
@pytest.mark.parametrize("ratio", [1.0, 0.8])
def test_a_healed_robot_is_the_robot_that_it_was(kind: str, ratio: float) -> None:
    names = ["actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "dof_damping", "geom_conaffinity"]
    names += ["pair_margin", "body_mass", "body_inertia", "body_subtreemass", "dof_invweight0"]
    world = SimServos(shipped()).world.model_copy(update={"friction_ratio": ratio})
    with SimServos(shipped(), world=world) as servos:
        model = servos.compiled.physics.model.ptr
        before = {name: getattr(model, name).copy() for name in names}
        failure = _event(f"{LEG}:{kind}@0").failure
        servos.change_leg(LEG, failure)
        servos.change_leg(5, Failure(leg=5, kind="limp"))
        servos.change_leg(LEG, None)
        assert servos.failures == (Failure(leg=5, kind="limp"),)
        servos.change_leg(5, None)
        for name in names:
            np.testing.assert_array_equal(getattr(model, name), before[name], err_msg=name)


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


KINDS = ("locked", "limp", "missing", "stuck:femur", "limp:tibia", "weak:0.2")


@pytest.mark.slow
def test_walks_whose_legs_fail_together_equal_each_alone() -> None:
    """Each in its own world, with its own failure and time; losses, delays and noise of the worlds too."""
    robot = shipped()
    plan = TrialPlan(gait=make_gait(robot, "tripod"), hold="line", duration_s=2.4)
    trials = [
        SimTrial(
            robot=robot,
            plan=plan,
            failure=None,
            world=world,
            events=[_event(f"{leg}:{kind}@{1 + 0.1 * leg}"), parse_healing(f"{leg}@2")],
        )
        for leg, kind in enumerate(KINDS, start=1)
        for world in ("flat", f"real:{leg}")
    ]
    together = run_sim_trials([*trials, trials[0]])
    assert together[0] == together[-1], "two of one start too"
    for trial, result in zip(trials, together[:-1], strict=True):
        assert result == run_sim_trial(trial)
    whole = run_sim_trial(SimTrial(robot=robot, plan=plan, failure=None, world="flat"))
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


@pytest.mark.parametrize("line", ['failures: ["5"]', 'failures: ["7:limp@3"]', 'healings: ["5:limp@3"]'])
def test_a_world_file_with_other_failures_is_refused_in_one_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text(line + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="allowed") as caught:
        load_world(path)
    assert "\n" not in str(caught.value)


def test_servos_that_are_off_stay_off_when_a_leg_heals() -> None:
    with SimServos(shipped()) as servos:
        servos.change_leg(LEG, Failure(leg=LEG, kind="limp"))
        servos.disable_torque()
        servos.change_leg(LEG, None)
        assert (servos.compiled.physics.model.actuator_gainprm[:, 0] == 0).all()
        servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
        assert (servos.compiled.physics.model.actuator_gainprm[:, 0] > 0).all()


@pytest.mark.parametrize("failure", [Failure(leg=5), Failure(leg=LEG, kind="unknown")])
def test_a_failure_that_no_leg_can_have_is_refused(failure: Failure) -> None:
    with SimServos(shipped()) as servos:
        with pytest.raises(InputError, match="failure: "):
            servos.change_leg(LEG, failure)
        assert servos.failures == ()
