"""What the paper leaves open: the documentation says it with the words of the report."""

from pathlib import Path

import pytest

from hexctl.backends.sim.world import World
from hexctl.control.assessment.uncertainty_store import (
    SimulationUncertainty,
    keep_uncertainty,
    known_uncertainty,
)
from hexctl.study.paper.evidence import cm
from hexctl.study.paper.study_report import assumptions
from hexctl.study.report_page import markdown
from tests.robots import shipped

DOCS = Path(__file__).parents[3] / "docs"


def test_the_page_has_the_table_of_the_report() -> None:
    table = "\n".join(markdown(assumptions())) + "\n"
    assert table in (DOCS / "assumptions.md").read_text(encoding="utf-8"), (
        "docs/assumptions.md differs from hexctl/study/templates/texts.yaml: replace its table with\n" + table
    )


def test_what_step_solver_and_contacts_change_is_what_was_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page has the numbers that come with hexctl, not copies of them nor those of this computer."""
    known = known_uncertainty("ant", folder=tmp_path)
    assert known is not None
    monkeypatch.chdir(tmp_path)
    other = SimulationUncertainty(step_m=0.5, solver_m=0.5, contact_m=0.5, walks=1000, duration_s=30.0)
    keep_uncertainty(shipped(), World(), other)
    simulator = assumptions().rows[-1][-1]
    for moved_m in (known.step_m, known.solver_m, known.contact_m):
        assert f"by {cm(moved_m)}" in simulator


def test_the_friction_cone_is_worth_what_the_decision_for_it_says() -> None:
    decisions = (DOCS / "decisions.md").read_text(encoding="utf-8")
    for words in ("17 to 49 cm", "0.0 to 0.8 cm"):
        assert words in assumptions().rows[-1][-1]
        assert words in decisions
