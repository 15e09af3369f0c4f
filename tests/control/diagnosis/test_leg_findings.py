"""What a standing test finds: each kind of failure, with what the robot tells about itself."""

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.control.controllers import Stand
from hexctl.control.diagnosis.leg_findings import Diagnosis, diagnosis_of, told_by_operator, unsafe_legs
from hexctl.control.diagnosis.standing_test import Observed, StandingTest
from hexctl.control.guard import Guard
from hexctl.control.loop import run_controller
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.loader import load_robot
from hexctl.types import RobotState

Blind = Callable[[RobotState], RobotState]


class _Test(StandingTest):
    """A standing test that is told less than the robot knows."""

    blind: Blind = staticmethod(lambda state: state)

    def targets_rad(self, step: int, state: RobotState) -> np.ndarray:
        return super().targets_rad(step, self.blind(state))


def _observed(
    name: str, leg: int | None, kind: str, world: str = "flat", blind: Blind | None = None
) -> Observed:
    robot = load_robot(name)
    failure = None if leg is None else parse_kind(leg, kind)
    with Guard(SimServos(robot, world=world, failure=failure, seed=3)) as guard:
        test = _Test(robot, guard.clock.period_s, unsafe=lambda observed: unsafe_legs(observed, robot))
        if blind is not None:
            test.blind = blind
        run_controller(guard, Stand(robot, guard.accepted_rad(), 20, 20))
        run_controller(guard, test)
    return test.observed


def _found(name: str, leg: int | None, kind: str, **more: object) -> Diagnosis:
    return diagnosis_of(_observed(name, leg, kind, **more), load_robot(name))  # type: ignore[arg-type]


CASES = [
    ("ant", 2, "locked", "leg 2 locked"),
    ("ant", 5, "limp", "leg 5 limp"),
    ("ant", 3, "missing", "leg 3 missing"),
    ("ant", 1, "limp:femur", "leg 1 limp:femur"),
    ("ant", 6, "stuck:tibia:-100", "leg 6 stuck:tibia:-100"),
    ("phantomx", 4, "stuck:coxa:8", "leg 4 stuck:coxa:8"),
    ("phantomx", 2, "weak:0.3", "leg 2 weak"),
    ("pexod", 1, "limp:tibia", "leg 1 limp:tibia"),
    ("pexod", 5, "stuck:femur:10", "leg 5 stuck:femur:10"),
]


@pytest.mark.parametrize(("name", "leg", "kind", "verdict"), CASES)
def test_each_kind_of_failure_is_found_and_no_other_leg_is_accused(
    name: str, leg: int, kind: str, verdict: str
) -> None:
    found = _found(name, leg, kind)
    (failure,) = found.failures
    wanted = parse_kind(leg, kind)
    assert found.verdict.startswith(verdict.rpartition(":")[0] if "stuck" in verdict else verdict)
    assert (failure.leg, failure.kind, failure.joint) == (wanted.leg, wanted.kind, wanted.joint)
    if wanted.kind == "stuck":
        assert failure.angle_rad == pytest.approx(wanted.angle_rad, abs=0.05)
    if wanted.kind == "weak":
        assert failure.torque_fraction == pytest.approx(0.3, abs=0.15)


@pytest.mark.parametrize("name", ["ant", "phantomx", "pexod"])
def test_a_whole_robot_is_not_accused(name: str) -> None:
    found = _found(name, None, "", world="real:205")
    assert found.failures == ()
    assert found.verdict == "no leg has failed"


def test_a_leg_whose_motions_were_all_stopped_is_not_called_good() -> None:
    robot = load_robot("ant")
    observed = _observed("ant", None, "")
    for section in observed.sections:
        if 3 in section.probe.legs:
            section.stopped = "the body leant by 13 degrees"
    found = diagnosis_of(observed, robot)
    assert not found.legs[2].tested
    assert found.verdict == "no leg has failed; not tested: leg 3"


def _echo(robot_name: str, *, contacts: bool, tilt: bool) -> Blind:
    stance = load_robot(robot_name).stance_angles_rad
    return lambda state: replace(
        state,
        measured=False,
        joint_positions_rad=stance,
        joint_torques_nm=None,
        foot_contacts=state.foot_contacts if contacts else None,
        base_quaternion_world=state.base_quaternion_world if tilt else None,
    )


@pytest.mark.parametrize("kind", ["locked", "missing"])
def test_servos_that_echo_leave_the_leg_to_the_contacts(kind: str) -> None:
    found = _found("ant", 4, kind, blind=_echo("ant", contacts=True, tilt=True))
    assert found.source == "contacts"
    assert found.verdict == "leg 4 unknown"
    assert found.legs[3].gains == (None, None, None)


def test_servos_that_echo_without_contacts_and_tilt_show_nothing_and_the_operator_is_believed() -> None:
    found = _found("ant", 4, "locked", blind=_echo("ant", contacts=False, tilt=False))
    assert found.source == "none"
    assert found.failures == ()
    assert found.verdict.startswith("not known")
    told = told_by_operator(found, {leg: leg != 4 for leg in range(1, 7)})
    assert told.source == "operator"
    assert told.verdict == "leg 4 unknown"


def test_without_torques_the_joints_still_tell_and_it_is_said_what_is_not_looked_for() -> None:
    found = _found("ant", 2, "stuck:coxa:8", blind=lambda state: replace(state, joint_torques_nm=None))
    assert found.verdict.startswith("leg 2 stuck:coxa")
    assert any("torques are not measured" in note for note in found.notes)


def test_a_contact_sensor_that_is_silent_under_a_good_leg_is_not_the_leg() -> None:
    def silent(state: RobotState) -> RobotState:
        assert state.foot_contacts is not None
        return replace(state, foot_contacts=state.foot_contacts & (np.arange(6) != 2))

    found = _found("ant", None, "", blind=silent)
    assert found.failures == ()
    assert "contact sensor" in found.legs[2].evidence


def _cut(whole: Observed, rows: int) -> Observed:
    """What was observed when a test is stopped after some rows."""
    sections = [
        replace(section, stop=section.stop if section.stop <= rows else 0)
        for section in whole.sections
        if section.start <= rows
    ]
    return Observed(sections=sections, measured=whole.measured, _rows=whole._rows[:rows])


def test_a_test_that_is_stopped_early_says_no_more_than_it_knows() -> None:
    whole, robot = _observed("ant", 5, "locked"), load_robot("ant")
    for rows in range(0, 70, 3):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = diagnosis_of(_cut(whole, rows), robot)
        assert not [note for note in found.notes if "measured" in note]
        assert found.failures == (), "leg 5 has not been tried yet"
        assert found.unfinished == (found.source == "none") == (rows < 18)
    early = diagnosis_of(_cut(whole, 6), robot).verdict
    assert early == "not known: the test ended before it showed anything"
    assert diagnosis_of(whole, robot).verdict == "leg 5 locked"
