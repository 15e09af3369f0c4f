"""The numbers of a study: Parquet tables and one JSON object."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.study.landscapes.landscape import NUMBERS, Landscape
from hexctl.study.landscapes.versions import code_versions
from hexctl.study.searches import Findings, Searches
from hexctl.study.verdicts.claim_evidence import Claim
from hexctl.study.verdicts.distance_criterion import BarRow, bar_rows
from hexctl.study.verdicts.trajectories import left_share, within
from hexctl.study.verdicts.verdict_uncertainty import StudyUncertainty

COUNT_NAMES = {True: "paper", False: "fresh"}

TABLES = ("landscapes.parquet", "convergence.parquet", "runs.parquet")


def write_tables(findings: Findings, folder: Path) -> None:
    """Write landscapes (a row per gait), convergence (per evaluation) and runs (per run and evaluation)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    searches = list(findings.searches.values())
    contents = (
        [_landscape_columns(landscape) for landscape in findings.landscapes.values()],
        [_curve_columns(search) for search in searches],
        [_run_columns(search) for search in searches],
    )
    for name, parts in zip(TABLES, contents, strict=True):
        pq.write_table(pa.concat_tables([pa.table(part) for part in parts]), folder / name)


def _landscape_columns(landscape: Landscape) -> dict[str, Any]:
    """Columns with a row per gait; paths end where the walk ended."""
    spec, n = landscape.spec, len(landscape.codes)
    paths = [path[np.isfinite(path[:, 0])] for path in landscape.paths_m]
    return {
        "robot": [spec.robot.name] * n,
        "leg": np.full(n, spec.leg),
        "failure": [spec.failure] * n,
        "self_rotation": [spec.self_rotation] * n,
        "code": landscape.codes,
        "slots": [spec.space.slots_of(code) for code in landscape.codes.tolist()],
        "status": landscape.status.tolist(),
        "final_m": landscape.final_m,
        **{name: landscape.number(name) for name in NUMBERS},
        "path_progress_m": [path[:, 0] for path in paths],
        "path_deviation_m": [path[:, 1] for path in paths],
    }


def _curve_columns(search: Searches) -> dict[str, Any]:
    """Columns with a row per evaluation."""
    curve, budget = search.curve, len(search.curve.mean)
    names = ("mean", "std", "median", "p10", "p90")
    return {
        **_head(search, budget),
        "evaluation": np.arange(1, budget + 1),
        **{f"{name}_m": getattr(curve, name) for name in names},
        "share_of_runs": curve.share,
    }


def _run_columns(search: Searches) -> dict[str, Any]:
    """Columns with a row per run and evaluation; code 0 follows the end of a run that tried all codes."""
    runs, budget = search.codes.shape
    return {
        **_head(search, runs * budget),
        "seed": np.repeat(search.seeds, budget),
        "evaluation": np.tile(np.arange(1, budget + 1), runs),
        "code": search.codes.ravel(),
        "score": search.scores.ravel(),
        "best_m": search.best_m.ravel(),
    }


def _head(search: Searches, rows: int) -> dict[str, Any]:
    return {
        "leg": np.full(rows, search.leg),
        "optimizer": [search.optimizer] * rows,
        "count": [COUNT_NAMES[search.paper_count]] * rows,
    }


#: Numbers of evaluations at which tables show the curves, up to the budget.
SHOWN = (1, 10, 20, 40, 60, 120)


def summary_json(
    findings: Findings, claims: Sequence[Claim], uncertainty: StudyUncertainty
) -> dict[str, Any]:
    """Settings and results of a study as JSON values; null where there is no number."""
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
        "failure": plan.failure,
        "self_rotation": plan.self_rotation,
        "worlds": plan.worlds,
        "uncertainty": uncertainty.as_json(),
        "code": code_versions(),
        "claims": [{**asdict(claim), "verdict": claim.verdict} for claim in claims],
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


def number(value: float) -> float | None:
    """Number for JSON: None for NaN and infinity."""
    return float(value) if math.isfinite(value) else None
