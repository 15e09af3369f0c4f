"""The numbers of a study: Parquet tables and one JSON object."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.study.experiment import plain
from hexctl.study.landscapes.landscape import NUMBERS, Landscape
from hexctl.study.landscapes.versions import code_versions
from hexctl.study.searches import Findings, Searches
from hexctl.study.verdicts.claim_evidence import number
from hexctl.study.verdicts.distance_criterion import BarRow, bar_rows
from hexctl.study.verdicts.trajectories import left_share, within

if TYPE_CHECKING:
    from pandas import DataFrame

COUNT_NAMES = {True: "paper", False: "fresh"}


def study_tables(findings: Findings) -> "dict[str, DataFrame]":
    """Return landscapes (a row per gait), convergence (per evaluation) and runs (per run and evaluation)."""
    from pandas import DataFrame, concat

    searches = list(findings.searches.values())
    contents = {
        "landscapes": [_landscape_columns(landscape) for landscape in findings.landscapes.values()],
        "convergence": [_curve_columns(search) for search in searches],
        "runs": [_run_columns(search) for search in searches],
    }
    return {name: concat([DataFrame(part) for part in parts]) for name, parts in contents.items()}


def _landscape_columns(landscape: Landscape) -> dict[str, Any]:
    """Columns with a row per gait; paths end where the walk ended."""
    spec = landscape.spec
    paths = [path[np.isfinite(path[:, 0])] for path in landscape.paths_m]
    return {
        "code": landscape.codes,
        "robot": spec.robot.name,
        "leg": spec.leg,
        "failure": spec.failure,
        "self_rotation": spec.self_rotation,
        "slots": [spec.space.slots_of(code) for code in landscape.codes.tolist()],
        "status": landscape.status.tolist(),
        "final_m": landscape.final_m,
        **{name: landscape.number(name) for name in NUMBERS},
        "path_progress_m": [path[:, 0] for path in paths],
        "path_deviation_m": [path[:, 1] for path in paths],
    }


def _curve_columns(search: Searches) -> dict[str, Any]:
    """Columns with a row per evaluation."""
    curve = search.curve
    return {
        **_head(search),
        "evaluation": np.arange(1, len(curve.mean) + 1),
        **{f"{name}_m": getattr(curve, name) for name in ("mean", "std", "median", "p10", "p90")},
        "share_of_runs": curve.share,
    }


def _run_columns(search: Searches) -> dict[str, Any]:
    """Columns with a row per run and evaluation; code 0 follows the end of a run that tried all codes."""
    runs, budget = search.codes.shape
    return {
        **_head(search),
        "seed": np.repeat(search.seeds, budget),
        "evaluation": np.tile(np.arange(1, budget + 1), runs),
        "code": search.codes.ravel(),
        "score": search.scores.ravel(),
        "best_m": search.best_m.ravel(),
    }


def _head(search: Searches) -> dict[str, Any]:
    return {"leg": search.leg, "optimizer": search.optimizer, "count": COUNT_NAMES[search.paper_count]}


#: Numbers of evaluations at which tables show the curves, up to the budget.
SHOWN = (1, 10, 20, 40, 60, 120)


def summary_json(findings: Findings) -> dict[str, Any]:
    """Return settings and results of a study as JSON values; null if there is no number."""
    plan = findings.plan
    names = [
        "legs",
        "optimizers",
        "runs",
        "budget",
        "duration_s",
        "seed",
        "failure",
        "self_rotation",
        "worlds",
    ]
    return {
        "robot": plan.robot.name,
        "world": plan.world.model_dump(mode="json"),
        **plain(plan, *names),
        "uncertainty": findings.uncertainty.as_json(),
        "code": code_versions(),
        "claims": [{**asdict(claim), "verdict": claim.verdict} for claim in findings.claims],
        "bars": [_bar(row) for count in (False, True) for row in bar_rows(findings, paper_count=count)],
        "landscapes": [_landscape(landscape) for landscape in findings.landscapes.values()],
        "default_gaits": [{**asdict(walk), "final_m": walk.final_m} for walk in findings.default_walks],
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
    """Mean over legs and runs after some numbers of evaluations."""
    curve = findings.mean_curve(optimizer, paper_count=paper_count)
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    searches = [findings.searches[leg, optimizer, paper_count] for leg in findings.searched]
    return {
        "optimizer": optimizer,
        "count": COUNT_NAMES[paper_count],
        "mean_m": {str(count): number(curve.mean[count - 1]) for count in shown},
        "std_m": {str(count): number(curve.std[count - 1]) for count in shown},
        "share_of_runs": {str(count): number(curve.share[count - 1]) for count in shown},
        "distinct_codes": [int(search.distinct.mean()) for search in searches],
        "own_codes_until_stuck": [round(float(search.own_codes.mean()), 1) for search in searches],
    }
