"""The walks of a repertoire: simulated together as alone, saved, and alike where the robot is symmetric."""

from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.control.body_symmetry import BodySymmetry
from hexctl.control.monitor.repertoire import Candidate
from hexctl.study.repertoire_walks import CandidateWalk, RepertoireCase
from hexctl.study.walk_cache import WalkCache
from tests.study.made_up_repertoire import plan


@pytest.mark.slow
def test_walks_together_are_those_alone() -> None:
    asked = plan()
    (place,) = asked.places()
    cases = list(asked.cases[:3])
    together = place.walk(cases)
    assert [one.case for one in together] == cases
    assert repr(place.walk(cases[1:2])) == repr(together[1:2])
    safest, on, _ = together
    assert (safest.status, on.status) == ("ok", "ok")
    assert 0.5 < safest.speed < 1.2
    assert on.speed != safest.speed
    assert safest.cost > 0


def test_the_failure_comes_before_the_change_and_its_phase_is_drawn() -> None:
    (place,) = plan().places()
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


@pytest.mark.slow
def test_a_mirrored_robot_walks_alike() -> None:
    """What a symmetry says of a leg is what simulating that leg says, in a world without sides."""
    asked = plan()
    place = replace(asked.places()[0], world=type(asked.places()[0].world)())
    mirror = BodySymmetry(legs=(1, 6, 5, 4, 3, 2), mirrored=True, turn_deg=0.0)
    safest = next(case for case in asked.cases if case.failures[0].startswith("2:"))
    moved = replace(
        safest,
        failures=(safest.failures[0].replace("2:", "6:"),),
        heading_deg=mirror.heading_before_deg(safest.heading_deg),
        candidate=safest.candidate.before(mirror),
    )
    walked, mirrored = (place.walk([case])[0] for case in (safest, moved))
    assert mirrored.speed == pytest.approx(walked.speed, abs=0.03)
    wrong = replace(moved, candidate=safest.candidate)  # tucks the leg that is whole
    assert place.walk([wrong])[0].speed < walked.speed - 0.05


def test_values_that_no_simulation_gives_are_refused() -> None:
    case = RepertoireCase(
        failures=("2:limp",), heading_deg=0.0, candidate=Candidate(name="x", slots=(1,) * 6)
    )
    fine = CandidateWalk(case=case, status="ok", speed=0.5, cost=0.3)
    assert fine.possible
    assert not replace(fine, status="fell").possible
    assert not replace(fine, speed=float("nan")).possible


def test_walks_are_kept_as_they_were(tmp_path: Path) -> None:
    (place,), cache = plan().places(), WalkCache(tmp_path)
    walks = [CandidateWalk(case=case, status="ok", speed=0.5, cost=0.3) for case in plan().cases]
    cache.save(place, walks)
    assert list(cache.load(place).values()) == walks
