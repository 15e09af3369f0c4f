"""The numbers of a study as Parquet files."""

from pathlib import Path
from typing import Any

import numpy as np

from hexctl.study.convergence import Searches
from hexctl.study.findings import Findings
from hexctl.study.landscape import NUMBERS, Landscape

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
    """Return a row per gait; the path is cut where the walk was over."""
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
    """Return a row per evaluation."""
    curve, budget = search.curve, len(search.curve.mean)
    names = ("mean", "std", "median", "p10", "p90")
    return {
        **_head(search, budget),
        "evaluation": np.arange(1, budget + 1),
        **{f"{name}_m": getattr(curve, name) for name in names},
        "share_of_runs": curve.share,
    }


def _run_columns(search: Searches) -> dict[str, Any]:
    """Return a row per run and evaluation; code 0 is after the end of a run that had tried everything."""
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
