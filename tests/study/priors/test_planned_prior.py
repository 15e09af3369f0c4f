"""Plans of the priors and repertoires that options ask for."""

from pathlib import Path

from hexctl.study.priors.planned_prior import planned_prior
from hexctl.study.priors.prior_building import PriorPlan
from hexctl.study.priors.prior_options import PriorOptions
from hexctl.study.repertoire_plan import RepertoirePlan


def test_walks_that_hold_their_line_do_not_turn_before() -> None:
    plans = [planned_prior(PriorOptions(hold=hold)).plan for hold in ("none", "heading", "line")]
    assert [plan.self_rotation for plan in plans] == ["rear", "rear", "none"]
    assert all(isinstance(plan, PriorPlan) and plan.worlds == 16 for plan in plans)


def test_a_repertoire_has_the_options_of_its_plan() -> None:
    options = PriorOptions(repertoire=True, family="transfer", directions=1, pairs=(), out=Path("x.npz"))
    planned = planned_prior(options)
    assert isinstance(planned.plan, RepertoirePlan)
    assert (list(planned.plan.families), planned.plan.worlds) == (["transfer"], 4)
    assert (planned.plan.directions, planned.plan.pair_failures, planned.plan.UNIT) == (1, (), "walks")
