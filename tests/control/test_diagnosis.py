"""The standing test: within the joints' limits, stopped where it is not safe, and what it finds."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from hexctl import Guard, LimitError, RobotState, SimServos, load_robot
from hexctl.control.controllers import Stand
from hexctl.control.diagnosis.leg_findings import Diagnosis, diagnosis_of, unsafe_legs
from hexctl.control.diagnosis.standing_test import (
    ALL_PROBES,
    LIFTS,
    Observed,
    StandingTest,
    probe_targets_rad,
)
from hexctl.control.loop import run_controller
from hexctl.ik.legs import foot_positions_body, range_excess_rad
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.rotations import quaternion_about
from tests.control.posed import Fault, Faulty

PERIOD_S = 0.02


@pytest.mark.parametrize("name", ["ant", "phantomx", "pexod"])
def test_every_probe_keeps_within_ranges_and_speeds_and_ends_in_the_stance(name: str) -> None:
    robot = load_robot(name)
    for probe in ALL_PROBES:
        targets = probe_targets_rad(robot, probe, PERIOD_S)
        whole = np.vstack([robot.stance_angles_rad, targets])
        assert range_excess_rad(robot, targets).max() <= 0
        assert (np.abs(np.diff(whole, axis=0)) <= robot.joint_max_speed_rad_s * PERIOD_S).all()
        np.testing.assert_allclose(targets[-1], robot.stance_angles_rad, atol=1e-9)
        if probe in LIFTS:  # each joint of its leg moves enough to be seen
            lifted = targets.reshape(-1, 6, 3)[:, probe.legs[0] - 1]
            assert (np.degrees(np.ptp(lifted, axis=0)) > 10).all()
            rise_m = np.ptp(foot_positions_body(robot, targets)[:, probe.legs[0] - 1, 2])
            assert 1.5 < rise_m / (robot.gait.height * robot.size_m) < 3, "in steps of its gait"
    assert sum(probe.duration_s for probe in ALL_PROBES) < 12


def test_a_robot_without_room_around_its_stance_is_refused() -> None:
    robot = load_robot("ant")
    angles = robot.stance_angles_rad
    tight = replace(robot, joint_lower_rad=angles - 1e-4, joint_upper_rad=angles + 1e-4)
    with pytest.raises(LimitError):
        StandingTest(tight, PERIOD_S)


def _state(tilt_rad: float, contacts: list[bool]) -> RobotState:
    robot = load_robot("ant")
    return RobotState(
        robot.stance_angles_rad,
        0.0,
        True,
        base_quaternion_world=quaternion_about((1, 0, 0), tilt_rad),
        foot_contacts=np.array(contacts),
    )


def _leg_height(targets_rad: np.ndarray, leg: int) -> float:
    return float(targets_rad[3 * leg - 2] - load_robot("ant").stance_angles_rad[3 * leg - 2])


def test_a_lean_puts_the_leg_down_at_once_and_the_next_one_follows() -> None:
    test = StandingTest(load_robot("ant"), PERIOD_S)
    level, leaning = _state(0.0, [True] * 6), _state(np.radians(15), [True] * 6)
    for step in range(20):
        raised = test.targets_rad(step, level)
    first = test.observed.sections[0]
    assert _leg_height(raised, first.probe.legs[0]) > 0.1
    lowered = test.targets_rad(20, leaning)
    assert _leg_height(lowered, first.probe.legs[0]) < _leg_height(raised, first.probe.legs[0])
    assert first.stopped is not None
    for step in range(21, 42):
        test.targets_rad(step, level)
    second = test.observed.sections[1]
    assert second.probe == LIFTS[1]
    assert second.stopped is None


@pytest.mark.parametrize("lean_known", [True, False])
def test_lost_contacts_of_the_other_feet_stop_a_lift_unless_the_body_is_level(lean_known: bool) -> None:
    contacts = [False, True, True, False, False, False]
    for tilt_deg in (0.0, 6.0):
        test = StandingTest(load_robot("ant"), PERIOD_S)
        test.targets_rad(0, _state(0.0, [True] * 6))
        for step in range(1, 12):
            state = _state(np.radians(tilt_deg), contacts)
            known = state if lean_known else replace(state, base_quaternion_world=None)
            test.targets_rad(step, known)
        stopped = test.observed.sections[0].stopped
        assert (stopped is not None) == (tilt_deg > 0 or not lean_known)


def _observed(
    name: str,
    leg: int | None,
    kind: str,
    world: str = "flat",
    seen: Fault = lambda state, _time_s: state,
) -> Observed:
    """What a standing test observes of a robot whose sensors show no more than `seen`."""
    robot = load_robot(name)
    failure = None if leg is None else parse_kind(leg, kind)
    servos = Faulty(SimServos(robot, world=world, failures=failure, seed=3), seen)
    with Guard(servos) as guard:
        test = StandingTest(robot, guard.clock.period_s, unsafe=lambda observed: unsafe_legs(observed, robot))
        run_controller(guard, Stand(robot, guard.accepted_rad(), 20, 20))
        run_controller(guard, test)
    return test.observed


def _found(name: str, leg: int | None, kind: str, **more: object) -> Diagnosis:
    return diagnosis_of(_observed(name, leg, kind, **more), load_robot(name))  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "leg", "kind"),
    [
        ("ant", 2, "locked"),
        ("ant", 3, "missing"),
        ("ant", 6, "stuck:tibia:-100"),
        ("phantomx", 2, "weak:0.3"),
        ("pexod", 1, "limp:tibia"),
        ("pexod", 5, "limp"),
    ],
)
def test_each_kind_of_failure_is_found_and_no_other_leg_is_accused(name: str, leg: int, kind: str) -> None:
    found = _found(name, leg, kind)
    (failure,) = found.failures
    wanted = parse_kind(leg, kind)
    assert found.verdict.startswith(f"leg {leg} {wanted.kind}")
    assert (failure.leg, failure.kind, failure.joint) == (wanted.leg, wanted.kind, wanted.joint)
    if wanted.kind == "stuck":
        assert failure.angle_rad == pytest.approx(wanted.angle_rad, abs=0.05)
    if wanted.kind == "weak":
        assert failure.torque_fraction == pytest.approx(0.3, abs=0.15)


def test_a_whole_robot_is_not_accused_nor_a_leg_called_good_whose_motions_were_stopped() -> None:
    observed, robot = _observed("ant", None, "", world="real:205"), load_robot("ant")
    assert diagnosis_of(observed, robot).verdict == "no leg has failed"
    for section in observed.sections:
        if 3 in section.probe.legs:
            section.stopped = "the body leant by 13 degrees"
    found = diagnosis_of(observed, robot)
    assert not found.legs[2].tested
    assert found.failures == ()
    assert found.verdict != "no leg has failed"


def test_servos_that_echo_leave_the_leg_to_the_contacts() -> None:
    def echo(state: RobotState, _time_s: float) -> RobotState:
        stance_rad = load_robot("ant").stance_angles_rad
        return replace(state, measured=False, joint_positions_rad=stance_rad, joint_torques_nm=None)

    found = _found("ant", 4, "locked", seen=echo)
    assert (found.source, found.verdict) == ("contacts", "leg 4 unknown")
    assert found.legs[3].gains == (None, None, None)


def test_without_torques_the_joints_still_tell_and_it_is_said_what_is_not_looked_for() -> None:
    found = _found(
        "ant", 2, "stuck:coxa:8", seen=lambda state, _time_s: replace(state, joint_torques_nm=None)
    )
    assert found.verdict.startswith("leg 2 stuck:coxa")
    assert any("torques are not measured" in note for note in found.notes)


def test_a_contact_sensor_that_is_silent_under_a_good_leg_is_not_the_leg() -> None:
    def silent(state: RobotState, _time_s: float) -> RobotState:
        assert state.foot_contacts is not None
        return replace(state, foot_contacts=state.foot_contacts & (np.arange(6) != 2))

    found = _found("ant", None, "", seen=silent)
    assert found.failures == ()
    assert "contact sensor" in found.legs[2].evidence


def _cut(whole: Observed, rows: int) -> Observed:
    """What was observed when a test is stopped after some rows."""
    sections = [
        replace(section, stop=section.stop if section.stop <= rows else 0)
        for section in whole.sections
        if section.start <= rows
    ]
    return Observed(sections=sections, measured=whole.measured, rows=whole.rows[:rows])


def test_a_test_that_is_stopped_early_says_no_more_than_it_knows() -> None:
    whole, robot = _observed("ant", 5, "locked"), load_robot("ant")
    for rows in range(0, 70, 6):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = diagnosis_of(_cut(whole, rows), robot)
        assert not [note for note in found.notes if "measured" in note]
        assert found.failures == (), "leg 5 has not been tried yet"
        assert found.unfinished == (found.source == "none") == (rows < 18)
    assert diagnosis_of(whole, robot).verdict == "leg 5 locked"
