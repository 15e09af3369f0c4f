"""Repertoires: which situations and candidates are walked, and how they are built."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.world import load_randomization
from hexctl.control.monitor.recovery import GlideToStableGait
from hexctl.control.monitor.repertoire import SAFEST, WALK_ON, load_repertoire, moved_parts, parts_of
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.study import repertoire_walks
from hexctl.study.repertoire_plan import RepertoirePlan, build_repertoire, repertoire_of
from hexctl.study.repertoire_walks import CandidateWalk, RepertoireCase, RepertoirePlace
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Work
from tests.robots import shipped
from tests.study.made_up import Remembering


def plan(name: str = "ant", **options: Any) -> RepertoirePlan:
    """Plan with the settings of a test."""
    asked: dict[str, Any] = {
        "robot": shipped(name),
        "families": {"transfer": load_randomization("transfer")},
        "worlds": 1,
        "directions": 2,
        "failures": ("stuck:femur",),
        "pair_failures": (),
        "codes": 0,
    }
    return RepertoirePlan(**asked | options)


@pytest.mark.parametrize(
    ("name", "directions", "alike", "walked"),
    [("ant", 12, 12, 7), ("phantomx", 6, 4, 9), ("pexod", 6, 2, 18)],
)
def test_of_situations_that_are_alike_one_is_walked(
    name: str, directions: int, alike: int, walked: int
) -> None:
    asked = plan(name, directions=directions)
    assert len(asked.symmetries) == alike
    assert len(asked.situations) == walked
    reached = {
        (moved_parts(parts_of(failures), one.legs), round(one.heading_deg(heading_deg)) % 360)
        for failures, heading_deg in asked.situations
        for one in asked.symmetries
    }
    assert len(reached) == 6 * directions


def test_the_first_candidate_is_what_a_recovery_does_without_a_repertoire() -> None:
    """But for the height of the body and the pace without two legs, which it gives to any candidate."""
    asked = plan(directions=12, pair_failures=("missing",))
    for failures, heading_deg in asked.situations[::3]:
        first, *others = asked.candidates(failures, heading_deg)
        trial = TrialPlan(gait=asked.gait, hold="line")
        rule = GlideToStableGait(None).respond(asked.robot, trial, heading_deg / 57.29577951, failures)
        ours = first.gait(asked.gait)
        assert rule.gait is not None
        posture = replace(rule.gait.posture, body_raise=ours.posture.body_raise)
        assert (first.name, ours) == (SAFEST, replace(rule.gait, pace_hz=ours.pace_hz, posture=posture))
        assert WALK_ON in [one.name for one in others]


def test_candidates_differ_and_can_be_walked() -> None:
    asked = plan(codes=2)
    found = asked.candidates((Failure(leg=2, kind="stuck", joint="femur"),), 0.0)
    assert len({one.gait(asked.gait) for one in found}) == len(found) == 8
    assert [one.name for one in found[:6]] == [
        "safest", "walk-on", "not raised", "not tucked", "code 2", "code 3",
    ]  # fmt: skip
    assert found[3].tucked_legs == ()
    assert found[2].body_raise == 0.0
    gone = asked.candidates((Failure(leg=2, kind="missing"),), 0.0)
    assert "not tucked" not in [one.name for one in gone]


def test_worlds_are_none_that_a_benchmark_uses_and_fewer_are_the_first_of_more() -> None:
    numbers = [one.number for one in plan(worlds=16).places()]
    assert numbers == list(range(100, 116))
    few, many = (plan(worlds=worlds).places() for worlds in (1, 3))
    assert few[0].fingerprint == many[0].fingerprint


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"worlds": 0}, "worlds"),
        ({"codes": 30}, "codes"),
        ({"failures": ("tired",)}, "tired"),
    ],
)
def test_what_is_not_allowed_is_refused(options: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        plan(**options).check()
    with pytest.raises(InputError, match=r"ends in \.npz"):
        build_repertoire(plan(), tmp_path / "x.zip", Work(cache=WalkCache(tmp_path)))


LIMP_PLAN = plan(worlds=2, directions=1, failures=("limp",))


@pytest.mark.slow
def test_what_was_interrupted_goes_on_from_what_has_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def walk(
        _place: RepertoirePlace, cases: Sequence[RepertoireCase], _threads: int = 1
    ) -> list[CandidateWalk]:
        return [CandidateWalk(case=case, status="ok", speed=0.5, cost=0.3) for case in cases]

    monkeypatch.setattr(RepertoirePlace, "walk", walk)
    monkeypatch.setattr(repertoire_walks, "TOGETHER", 1)
    cache, out = WalkCache(tmp_path / "cache"), tmp_path / "ant.npz"
    with pytest.raises(KeyboardInterrupt):
        build_repertoire(LIMP_PLAN, out, Work(cache=cache, jobs=1, progress=Remembering(interrupt_after=5)))
    assert not out.exists()
    saved, total = cache.count(LIMP_PLAN.walked())
    assert 0 < saved < total
    left = Remembering()
    built = build_repertoire(LIMP_PLAN, out, Work(cache=cache, jobs=1, progress=left))
    assert left.steps == total - saved
    assert load_repertoire(out).digest == built.digest
    again = Remembering()
    build_repertoire(LIMP_PLAN, out, Work(cache=cache, jobs=1, progress=again))
    assert again.steps == 0


def test_a_repertoire_says_how_its_candidates_walked() -> None:
    walks = [
        CandidateWalk(
            case=case,
            status="ok",
            speed=0.9 if case.candidate.name == "walk-on" else 0.5 + 0.1 * place,
            cost=0.3,
        )
        for place, (_, cases) in enumerate(LIMP_PLAN.walked())
        for case in cases
    ]
    repertoire = repertoire_of(LIMP_PLAN, walks)
    first = repertoire.situations[0]
    assert first.walks == 2
    np.testing.assert_allclose(first.speeds[0], [0.5, 0.6])
    for leg in range(1, 7):
        choice = repertoire.choice((Failure(leg=leg, kind="limp"),), 0.0)
        assert choice is not None
        assert choice.candidate.name == "walk-on"
    assert repertoire.choice((Failure(leg=1, kind="locked"),), 0.0) is None


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
