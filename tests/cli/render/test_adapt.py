"""Sessions as text: the simulation's own uncertainty beside what they found."""

from dataclasses import replace

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.sessions.session import BaselineRecord, Session, SessionSpec, TrialRecord
from hexctl.cli.render.adapt import closing_lines, opening_line, session_line

SPEC = SessionSpec(optimizer="bayes", prior="x.npz", target_m=0.025)

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


def test_the_best_deviation_has_its_uncertainty_beside_it() -> None:
    closing = closing_lines(session(uncertainty_m=0.0213), "budget")
    assert "0.006 m ± 0.021 m by the simulation's own uncertainty\n" in closing
    assert "deviations ± 0.021 m by the simulation's own uncertainty" in opening_line(
        session(uncertainty_m=0.0213)
    )
    assert "best 0.006 m ± 0.021 m (code 17)" in session_line(session(uncertainty_m=0.0213))


def test_where_it_is_not_known_nothing_is_said_of_it() -> None:
    for text in (closing_lines(session(), "budget"), opening_line(session()), session_line(session())):
        assert "±" not in text
        assert "uncertainty" not in text


def test_a_target_that_no_gait_can_be_confirmed_within_is_said_in_one_line() -> None:
    text = closing_lines(session(uncertainty_m=0.0213), "not worth another trial")
    (line,) = (line for line in text.splitlines() if "confirmed" in line)
    assert line == (
        "no gait can be confirmed within 0.025 m: with the simulation's own uncertainty, ± 0.021 m, even one "
        "that ends on the line is within it to 76 % only, not 90 %"
    )
    for distinct in ({"uncertainty_m": 0.014}, {"uncertainty_m": 0.0213, "optimizer": "pso"}, {}):
        assert "can be confirmed" not in closing_lines(session(**distinct), "budget")


def with_tripod(score: float, **changes: object) -> Session:
    """The session with a walk of the tripod before it."""
    walk = BaselineRecord(
        gait="tripod", code=None, slots=(0,) * 6, score=score, outcome=OUTCOME, path_m=[], recording=None
    )
    whole = session(**changes)
    whole.baseline.append(walk)
    return whole


def test_a_gait_within_the_uncertainty_of_the_best_trial_is_not_called_better_or_worse() -> None:
    for tripod in (0.001, 0.05):
        text = closing_lines(with_tripod(tripod, uncertainty_m=0.0213), "budget")
        said = f"without a search: tripod {tripod:.3f} m ± 0.021 m"
        assert f"{said}; the best trial is not distinguishable from tripod" in text.splitlines()
    whole = with_tripod(0.001, uncertainty_m=0.0213)
    assert whole.best is not None
    whole.baseline[0] = replace(whole.baseline[0], gait="auto", slots=whole.best.slots)
    text = closing_lines(whole, "budget")
    assert "; the best trial walks the gait auto" in text
    assert "not distinguishable from auto" not in text
    text = closing_lines(with_tripod(0.08, uncertainty_m=0.0213), "budget")  # 7.4 cm: 3.5 times 2.1 cm
    assert "without a search: tripod 0.080 m ± 0.021 m" in text.splitlines()
    text = closing_lines(with_tripod(0.001, uncertainty_m=0.0013), "budget")
    assert "; no trial is better than tripod" in text
    unbeaten = replace(
        with_tripod(0.001),
        baseline=[replace(with_tripod(0.001).baseline[0], gait=name) for name in ("auto", "demo", "tripod")],
    )
    assert "; no trial is better than auto, demo and tripod" in closing_lines(unbeaten, "budget")
    text = closing_lines(with_tripod(0.001), "budget")  # not known: as they are
    assert "without a search: tripod 0.001 m; no trial is better than tripod" in text.splitlines()


def test_a_milestone_has_the_uncertainty_of_the_walk_that_reached_it() -> None:
    lines = closing_lines(session(uncertainty_m=0.0213), "budget").splitlines()
    assert "within 0.025 m: after 1 trial, ± 0.021 m" in lines


def test_the_uncertainty_is_only_of_the_end_of_a_walk() -> None:
    """Sessions of before may have stored one with another objective: its ± was metres, whatever the unit."""
    turned = session(uncertainty_m=0.0213, objective="scores:heading_lost", objective_unit="rad")
    for text in (closing_lines(turned, "budget"), opening_line(turned), session_line(turned)):
        assert "±" not in text


def test_which_walks_were_measured_is_said_where_they_are_others() -> None:
    borrowed = session(uncertainty_m=0.0213, uncertainty_caveat="measured on the flat world")
    for text in (closing_lines(borrowed, "budget"), opening_line(borrowed)):
        assert "0.021 m by the simulation's own uncertainty (measured on the flat world)" in text


def walk_on(**changes: object) -> list[str]:
    lines = closing_lines(session(failed_leg=5, **changes), "budget").splitlines()
    return [line for line in lines if line.startswith("walk on with: ")]


def test_every_search_that_found_a_gait_says_how_to_walk_with_it() -> None:
    steered = {"objective": "speed", "hold": "auto", "self_rotation": "none", "body_raise": 0.012}
    begin = "walk on with: hexctl run --failed-leg 5 --gait 17"
    assert walk_on(**steered) == [f"{begin} --body-raise 0.012 --self-rotation none"]
    assert walk_on(hold="none", heading_deg=20.0) == [
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
    assert [walk.gait for walk in both.better_baseline] == ["auto", "tripod"]


def test_before_the_first_trial_nothing_is_said_of_what_can_be_confirmed() -> None:
    none_yet = replace(with_tripod(0.001, uncertainty_m=0.0213), trials=[])
    text = closing_lines(none_yet, "interrupted")
    assert "confirmed" not in text
    assert "walk on with" not in text
