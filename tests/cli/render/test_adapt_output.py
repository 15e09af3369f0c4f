"""Sessions as text: the simulation's own uncertainty beside what they found."""

import math
from dataclasses import replace

import pytest

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.search_progress import CONFIRMATION_WALKS
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import BaselineRecord, ConfirmationRecord, TrialRecord
from hexctl.cli.render.adapt_output import (
    baseline_line,
    confirmation_line,
    opening_lines,
    trial_line,
)
from tests.adapt.walking import closing_lines

SPEC = SessionSpec(failed_leg=5, optimizer="bayes", prior="x.npz", target_m=0.025)

OUTCOME = {
    "status": "ok",
    "duration_s": 30.0,
    "distance_m": 3.2,
    "deviation_m": {"signed": 0.006},
    "yaw_change_deg": 0.0,
    "clipped_ticks": 0,
}


def session(**changes: object) -> Session:
    """A session with one trial, 6 mm off the line."""
    trial = TrialRecord(
        index=1, code=17, slots=(1, 2, 3, 4, 0, 5), score=0.006, outcome=OUTCOME, path_m=[], recording=None
    )
    spec = replace(SPEC, **changes)  # type: ignore[arg-type]
    return Session(name="s", spec=spec, created="2026-01-01", trials=[trial], ended="budget")


def test_what_is_known_of_the_end_is_one_line() -> None:
    lines = closing_lines(session(uncertainty_m=0.0213), "budget").splitlines()
    assert lines[:2] == [
        "found: gait 17, trial 1, ends 0.6 cm left of its line",
        "accuracy: ± 2.1 cm by the simulation's time step",
    ]
    assert "± 2.1 cm" in "\n".join(opening_lines(session(uncertainty_m=0.0213)))


def test_if_nothing_is_known_of_the_uncertainty_nothing_is_printed_of_it() -> None:
    for text in (closing_lines(session(), "budget"), "\n".join(opening_lines(session()))):
        assert "±" not in text
        assert "accuracy" not in text


def test_a_real_robot_has_the_chance_that_its_optimizer_gives() -> None:
    real = session(backend="zenoh", world=None)
    real.settled_on = {"code": 17, "chance": 0.65, "target_m": 0.025}
    assert "chance: 65 % that gait 17 ends within 2.5 cm" in closing_lines(real, "budget").splitlines()


@pytest.mark.parametrize(
    ("signed_m", "words"),
    [(-0.002, "within 2.5 cm"), (0.2, "not within 2.5 cm"), (0.02, "perhaps within 2.5 cm")],
)
def test_a_confirmed_end_is_the_one_that_is_printed(signed_m: float, words: str) -> None:
    confirmed = session(uncertainty_m=0.0213, confirmed_uncertainty_m=0.008)
    confirmed.confirmations = [
        ConfirmationRecord(
            code=17,
            slots=confirmed.trials[0].slots,
            score=abs(signed_m),
            outcome={**OUTCOME, "deviation_m": {"signed": signed_m}},
            path_m=[],
            recording=None,
            time_step_s=0.0005,
        )
    ]
    side = "left" if signed_m > 0 else "right"
    assert closing_lines(confirmed, "budget").splitlines()[:2] == [
        f"found: gait 17, trial 1, ends {100 * abs(signed_m):.1f} cm {side} of its line",
        f"accuracy: ± 0.8 cm by a walk at a time step of 0.5 ms; {words}",
    ]
    assert str(confirmation_line(confirmed, confirmed.confirmations[0])).endswith("ok at 0.5 ms")


def with_tripod(score: float, **changes: object) -> Session:
    """The session with a walk of the tripod before it."""
    walk = BaselineRecord(
        gait="tripod", code=None, slots=(0,) * 6, score=score, outcome=OUTCOME, path_m=[], recording=None
    )
    whole = session(**changes)
    whole.baseline.append(walk)
    return whole


def test_the_summary_has_six_lines_and_none_of_a_walk_is_wider_than_a_terminal() -> None:
    whole = with_tripod(0.1, uncertainty_m=0.0213)
    whole.trials[0] = replace(whole.trials[0], recording="trial-001.rrd")
    lines = closing_lines(whole, "not worth another trial").splitlines()
    assert [line.partition(":")[0].split(" after")[0] for line in lines] == [
        *("found", "accuracy", "without a search", "ended", "walk on with", "look at it with"),
    ]
    assert "not worth" not in "\n".join(lines)
    fallen = replace(whole.trials[0], outcome={**OUTCOME, "status": "no_progress", "cause": "saturation"})
    shown = [baseline_line(whole, whole.baseline[0]), trial_line(whole, fallen), *opening_lines(whole)]
    assert max(len(str(line)) for line in (*shown, *lines[:4])) <= 80


def test_a_search_that_can_be_continued_counts_the_walks_before_its_trials() -> None:
    begun = with_tripod(0.1, budget=3)
    begun.trials.clear()
    (line,) = (line for line in closing_lines(begun, None).splitlines() if line.startswith("unfinished"))
    for word in ("0 trials", "1 walk ", "30 s walked", "hexctl adapt --resume s"):
        assert word in line


def test_the_walks_besides_the_trials_are_explained_where_the_bar_counts_them() -> None:
    planned = session(baseline_gaits=["auto", "demo", "tripod"], confirmed_uncertainty_m=0.008)
    assert not [line for line in opening_lines(session()) if "first" in line or "last" in line]
    planned.trials.clear()
    (line,) = (line for line in opening_lines(planned) if line.startswith("first 3 walks"))
    assert f"{CONFIRMATION_WALKS} walks" in line
    assert len(line) <= 80


def test_the_search_is_compared_with_the_gaits_that_need_none() -> None:
    def compared(whole: Session) -> str:
        lines = closing_lines(whole, "budget").splitlines()
        return next(line for line in lines if line.startswith("without a search: "))

    assert compared(with_tripod(0.1)) == "without a search: tripod 10.0 cm; the search gains 9.4 cm"
    unresolved = with_tripod(0.05, uncertainty_m=0.0213)
    assert compared(unresolved) == "without a search: tripod 5.0 cm; the search found none better"
    fell = with_tripod(0.1)
    walk = replace(fell.baseline[0], score=INVALID_SCORE, outcome={**OUTCOME, "status": "fell"})
    fell.baseline[0] = walk
    assert compared(fell) == "without a search: tripod fell"


def test_the_uncertainty_is_only_of_the_end_of_a_walk() -> None:
    """One that is given with another objective is in metres, whatever the unit of its scores."""
    turned = session(uncertainty_m=0.0213, objective="scores:heading_lost", objective_unit="rad")
    for text in (closing_lines(turned, "budget"), "\n".join(opening_lines(turned))):
        assert "±" not in text


def test_which_walks_were_measured_is_printed_if_they_are_others() -> None:
    borrowed = session(uncertainty_m=0.0213, uncertainty_caveat="measured on the flat world")
    assert opening_lines(borrowed)[-1] == "ends are known to ± 2.1 cm (measured on the flat world)"


def walk_on(**changes: object) -> list[str]:
    lines = closing_lines(session(failed_leg=5, **changes), "budget").splitlines()
    return [line for line in lines if line.startswith("walk on with: ")]


def test_every_search_that_found_a_gait_says_how_to_walk_with_it() -> None:
    steered = {"objective": "speed", "hold": "auto", "self_rotation": "none", "body_raise": 0.012}
    begin = "walk on with: hexctl run --failed-leg 5 --gait 17"
    assert walk_on(**steered) == [f"{begin} --body-raise 0.012 --self-rotation none"]
    assert walk_on(hold="none", heading_rad=math.radians(20.0)) == [
        f"{begin} --hold none --heading 20 --self-rotation rear"
    ]
    assert walk_on(optimizer="trim", hold="none") == [], "it has learned no trim"


def test_a_gait_without_a_search_that_no_trial_is_better_than_is_the_one_to_walk_on_with() -> None:
    def gait_of(whole: Session) -> str:
        (line,) = (line for line in closing_lines(whole, "budget").splitlines() if line.startswith("walk on"))
        return line.partition(" --gait ")[2].partition(" ")[0]

    assert gait_of(with_tripod(0.001)) == "tripod"
    assert gait_of(with_tripod(0.008)) == "17", "the trial is better"
    assert gait_of(with_tripod(0.001, uncertainty_m=0.0213)) == "tripod", "not resolved: no search is needed"
    both = with_tripod(0.003)
    stable = replace(both.baseline[0], gait="auto", code=42, score=0.002)
    both.baseline.append(stable)
    assert gait_of(both) == "42", "the better one of two; auto by its code"
    both.baseline[1] = replace(stable, code=None, slots=(1, 3, 6, 2, 5, 4))
    assert gait_of(both) == "1,3,6,2,5,4"
    both.trials[0] = replace(both.trials[0], score=INVALID_SCORE, outcome={**OUTCOME, "status": "fell"})
    assert gait_of(both) == "1,3,6,2,5,4", "no trial is valid"


def test_before_the_first_trial_nothing_is_said_of_what_can_be_confirmed() -> None:
    none_yet = replace(with_tripod(0.001, uncertainty_m=0.0213), trials=[])
    text = closing_lines(none_yet, "interrupted")
    assert "confirmed" not in text
    assert "walk on with" not in text
