"""The walks of a repertoire: simulated together as alone, saved, and alike where the robot is symmetric."""

from dataclasses import replace

import pytest

from hexctl.control.monitor.repertoire import BodySymmetry, Candidate
from hexctl.study.repertoire.repertoire_walks import CandidateWalk, RepertoireCase, walk_cases
from tests.study.repertoire.made_up import plan


def test_walks_together_are_those_alone() -> None:
    asked = plan()
    (place,) = asked.conditions()
    cases = list(asked.cases[:3])
    together = walk_cases(place, cases)
    assert [one.case for one in together] == cases
    assert repr(walk_cases(place, cases[1:2])) == repr(together[1:2])
    safest, on, _ = together
    assert (safest.status, on.status) == ("ok", "ok")
    assert 0.5 < safest.speed < 1.2
    assert on.speed != safest.speed
    assert safest.cost > 0


def test_the_failure_comes_before_the_change_and_its_phase_is_drawn() -> None:
    (place,) = plan().conditions()
    times: dict[tuple[object, ...], set[float]] = {}
    for case in plan().cases:
        trial = place.trial(case)
        (event,) = trial.events
        (change,) = trial.plan.changes
        before_cycles = (change.at_s - event.at_s) * trial.plan.gait.pace_hz
        assert 0.39 < before_cycles < 1.41
        assert change.gait == case.candidate.gait(trial.plan.gait)
        times.setdefault((case.failures, case.heading_deg), set()).add(event.at_s)
    assert all(len(moments) == 1 for moments in times.values()), "the same for all candidates"
    assert len({moment for moments in times.values() for moment in moments}) > 2


def test_a_mirrored_robot_walks_alike() -> None:
    """What a symmetry says of a leg is what simulating that leg says, in a world without sides."""
    asked = plan()
    place = replace(asked.conditions()[0], world=type(asked.conditions()[0].world)())
    mirror = BodySymmetry(legs=(1, 6, 5, 4, 3, 2), mirrored=True, turn_deg=0.0)
    safest = next(case for case in asked.cases if case.failures[0].startswith("2:"))
    moved = replace(
        safest,
        failures=(safest.failures[0].replace("2:", "6:"),),
        heading_deg=mirror.heading_before_deg(safest.heading_deg),
        candidate=safest.candidate.before(mirror),
    )
    walked, mirrored = (walk_cases(place, [case])[0] for case in (safest, moved))
    assert mirrored.speed == pytest.approx(walked.speed, abs=0.03)
    wrong = replace(moved, candidate=safest.candidate)  # tucks the leg that is whole
    assert walk_cases(place, [wrong])[0].speed < walked.speed - 0.05


def test_values_that_no_simulation_gives_are_refused() -> None:
    case = RepertoireCase(
        failures=("2:limp",), heading_deg=0.0, candidate=Candidate(name="x", slots=(1,) * 6)
    )
    known = {
        "case": {"failures": ["2:limp"], "heading_deg": 0.0, "candidate": {"name": "x", "slots": [1] * 6}}
    }
    fine = CandidateWalk.from_dict(known | {"status": "ok", "speed": 0.5, "cost": 0.3})
    assert fine.case == case
    for bad in ({"status": "fell", "speed": 0.5}, {"status": "ok", "speed": float("nan")}, {"status": "so"}):
        with pytest.raises(ValueError, match="no simulation gives"):
            CandidateWalk.from_dict(known | {"status": "ok", "speed": 0.5, "cost": 0.3} | bad)
