"""Sessions as text: the simulation's own uncertainty beside what they found."""

from dataclasses import replace

from hexctl.adapt.session import Session, SessionSpec, TrialRecord
from hexctl.cli.render_adapt import closing_lines, opening_line, session_line

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
