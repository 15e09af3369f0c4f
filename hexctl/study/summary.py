"""A study as one JSON object, and in a few lines."""

import math
from dataclasses import asdict
from typing import Any

from hexctl.study.bars import BarRow, bar_rows
from hexctl.study.claims import claims_of
from hexctl.study.findings import Findings
from hexctl.study.landscape import Landscape
from hexctl.study.tables import COUNT_NAMES
from hexctl.study.versions import code_versions
from hexctl.study.walk_claims import left_share, within

#: Evaluations at which tables show the curves, as far as the budget goes.
SHOWN = (1, 10, 20, 40, 60, 120)


def summary_json(findings: Findings) -> dict[str, Any]:
    """Return what was asked and found as JSON values; null where there is no number."""
    plan = findings.plan
    return {
        "robot": plan.robot.name,
        "world": plan.world.model_dump(mode="json"),
        "legs": list(plan.legs),
        "optimizers": list(plan.optimizers),
        "runs": plan.runs,
        "budget": plan.budget,
        "duration_s": plan.duration_s,
        "seed": plan.seed,
        "code": code_versions(),
        "claims": [{**asdict(claim), "verdict": claim.verdict} for claim in claims_of(findings)],
        "bars": [_bar(row) for count in (False, True) for row in bar_rows(findings, paper_count=count)],
        "landscapes": [_landscape(landscape) for landscape in findings.landscapes.values()],
        "convergence": [
            _curve(findings, name, paper_count=count) for count in (False, True) for name in plan.optimizers
        ],
    }


def _bar(row: BarRow) -> dict[str, Any]:
    return {
        "optimizer": row.optimizer,
        "count": COUNT_NAMES[row.paper_count],
        "evaluations": row.evaluations,
        "leg": row.leg,
        "mean_m": number(row.mean_m),
        "limit_m": number(row.limit_m),
        "share_of_runs": row.share,
        "holds": row.holds,
    }


def _landscape(landscape: Landscape) -> dict[str, Any]:
    return {
        "leg": landscape.spec.leg,
        "self_rotation": landscape.spec.self_rotation,
        "gaits": len(landscape.codes),
        "valid": int(landscape.valid.sum()),
        "left_share": number(left_share(landscape)),
        "within_0.10_m": within(landscape, 0.10),
        "within_0.025_m": within(landscape, 0.025),
        "best_m": number(landscape.best_m),
    }


def _curve(findings: Findings, optimizer: str, *, paper_count: bool) -> dict[str, Any]:
    """Return the mean over legs and runs at some evaluations."""
    curve = findings.mean_curve(optimizer, paper_count=paper_count)
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    searches = [findings.searches[leg, optimizer, paper_count] for leg in findings.plan.legs]
    return {
        "optimizer": optimizer,
        "count": COUNT_NAMES[paper_count],
        "mean_m": {str(count): number(curve.mean[count - 1]) for count in shown},
        "std_m": {str(count): number(curve.std[count - 1]) for count in shown},
        "share_of_runs": {str(count): number(curve.share[count - 1]) for count in shown},
        "distinct_codes": [int(search.distinct.mean()) for search in searches],
        "own_codes_until_stuck": [round(float(search.own_codes.mean()), 1) for search in searches],
    }


def number(value: float) -> float | None:
    """Return a number as JSON knows it: None for NaN and infinity."""
    return float(value) if math.isfinite(value) else None
