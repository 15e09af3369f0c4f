"""The report of a study: one HTML page that needs no other file, with figures and tables next to it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.study.experiment import plain
from hexctl.study.landscapes.landscape import NUMBERS, Landscape
from hexctl.study.landscapes.versions import code_versions
from hexctl.study.reports.report_page import Block, Bullets, Fold, Picture, Section, Table
from hexctl.study.reports.texts import reading, texts
from hexctl.study.searches import BASELINE, NULL_DRAWS, Curve, Findings, Searches
from hexctl.study.verdicts.assumptions import HEADER, assumption_rows
from hexctl.study.verdicts.claim_evidence import EARLY, EARLY_M, LATE, LATE_M, Claim, cm, limit_text, number
from hexctl.study.verdicts.claims import LATE_ABOVE_BEST_M, BarRow, bar_rows, expected_best_rank
from hexctl.study.verdicts.trajectories import left_share, within

if TYPE_CHECKING:
    from pandas import DataFrame


def study_sections(findings: Findings, pictures: Mapping[str, Picture]) -> Iterator[Section]:
    """Return the parts of the report of a study."""
    world = findings.plan.world.model_dump()
    values = [(name, str(value)) for name, value in world.items() if name != "sensor_noise"]
    parameters = Fold("Parameters of the world", Table(("parameter", "value"), values))
    sentence = findings.uncertainty.sentence
    yield Section("", [summary(findings), _settings(findings), sentence, parameters])
    header = ("claim of the paper", "holds here if", "measured here", "beside it", "verdict")
    rows = [(one.claim, one.rule, one.measured, _beside(one), one.verdict) for one in findings.claims]
    yield Section("Claims of the paper", [Table(header, rows)])
    ranks = {"early": expected_best_rank(EARLY), "late": expected_best_rank(LATE)}
    yield reading("study", Bullets([_stuck(findings)]), draws=NULL_DRAWS, **ranks)
    left_open = (
        "What the paper leaves open, and how it is read here; numbers are those of ant on the flat "
        "floor, leg locked, after the turn."
    )
    yield Section("Assumptions", [left_open, Table(HEADER, assumption_rows())])
    yield Section("The bar: mean over legs and runs", _bar_blocks(findings))
    if findings.default_walks:
        yield Section("Without a search", [texts("default_gaits"), _defaults(findings)])
    for name, picture in pictures.items():
        yield Section(name.replace("_", " ").capitalize(), [picture])
    yield from _numbers(findings)


def _bar_blocks(findings: Findings) -> list[Block]:
    late = limit_text(LATE_M)
    bar = (
        f"{limit_text(EARLY_M)} within {EARLY} evaluations; within {LATE}, {late}, or, for a leg whose best "
        f"gait of all is above {late}, {limit_text(LATE_ABOVE_BEST_M)} more than that gait. Beside it the "
        "random baseline, which has to hold it too."
    )
    fresh, paper = (_bars(findings, paper_count=count) for count in (False, True))
    return [bar, "Each gait paid for once:", fresh, "By the paper's count:", paper]


def _numbers(findings: Findings) -> Iterator[Section]:
    yield Section("Landscapes", [_landscapes(findings)])
    yield Section("Means over all legs and runs, with standard deviation", [_means(findings)])
    title = "Means of each leg over its runs, with standard deviation, by the paper's count"
    yield Section(title, [_leg_means(findings)])
    distinct = (
        "Mean over runs: codes of its own until the search is stuck / different codes that the paper's "
        "count buys."
    )
    yield Section("Distinct codes", [distinct, _distinct(findings)])


def _settings(findings: Findings) -> str:
    plan = findings.plan
    return (
        f"Robot {plan.robot.name}; legs {', '.join(str(leg) for leg in plan.legs)}, each {plan.failure}; all "
        f"120 gaits, {plan.duration_s:g} s each, self-rotation {' and '.join(plan.rotations)}; claims judged "
        f"over {plan.worlds} world{'s' * (plan.worlds > 1)}; then {', '.join(plan.optimizers)} with "
        f"{plan.runs} seeded runs of {plan.budget} evaluations, looked up in the landscapes with "
        f"self-rotation {plan.self_rotation}. "
        f"Seed {plan.seed}."
    )


def _stuck(findings: Findings) -> str:
    """After how many codes the searches of this study were stuck."""
    means = {
        name: [float(findings.searches[leg, name, True].own_codes.mean()) for leg in findings.searched]
        for name in findings.heuristics
    }
    each = ", ".join(f"{name} after {min(of):.0f} to {max(of):.0f}" for name, of in means.items())
    return (
        f"Distinct codes until a search is stuck, means of the runs of each leg: {each or 'none searched'}."
    )


def _beside(claim: Claim) -> str:
    """What a claim is compared with: the baseline, symmetries, random numbers."""
    null = f"random numbers: {claim.null}" if claim.null else ""
    symmetric = f"symmetry: {claim.symmetric}" if claim.symmetric else ""
    return "; ".join(text for text in (claim.beside, symmetric, null) if text)


def _bars(findings: Findings, *, paper_count: bool) -> Table:
    legs = [f"leg {leg}" for leg in findings.searched]
    rows = bar_rows(findings, paper_count=paper_count)
    header = ("optimizer", "evaluations", "bar", "mean", "verdict", *legs)
    return Table(header, list(_bar_lines(rows, len(legs))))


def _bar_lines(rows: list[BarRow], legs: int) -> Iterator[list[str]]:
    """One row of cells per optimizer and bar: all legs together, then each."""
    for first in range(0, len(rows), legs + 1):
        together, *each = rows[first : first + legs + 1]
        mean = cm(together.mean_m) + _share(together.share)
        head = [together.optimizer, str(together.evaluations), cm(together.limit_m), mean]
        yield [*head, together.verdict] + [_leg_cell(row) for row in each]


def _leg_cell(row: BarRow) -> str:
    over = f" (+{cm(row.over_m)})" if row.holds is False else ""
    return cm(row.mean_m) + over + _share(row.share)


def _share(share: float) -> str:
    return "" if share == 1 else f" [{share:.0%} of the runs]"


def _landscapes(findings: Findings) -> Table:
    header = ("leg", "self-rotation", "gaits", "valid", "end left", "within 10 cm", "within 2.5 cm", "best")
    rows = [
        (
            str(landscape.spec.leg),
            landscape.spec.self_rotation,
            str(len(landscape.codes)),
            str(int(landscape.valid.sum())),
            f"{left_share(landscape):.0%}",
            str(within(landscape, EARLY_M)),
            str(within(landscape, LATE_M)),
            findings.uncertainty.beside(landscape.best_m),
        )
        for landscape in findings.landscapes.values()
    ]
    return Table(header, rows)


def _defaults(findings: Findings) -> Table:
    """The robot's own gaits beside the landscape and the searches of each leg."""
    names = list(dict.fromkeys(walk.gait for walk in findings.default_walks))
    after = min(EARLY, findings.plan.budget)
    searches = [f"{name} after {after}" for name in findings.plan.optimizers]
    header = ("leg", *names, "median of all valid gaits", "best of all gaits", *searches)
    return Table(header, [_default_row(findings, leg, after) for leg in findings.searched])


def _default_row(findings: Findings, leg: int, after: int) -> list[str]:
    landscape = findings.rotated(leg)
    valid_m = landscape.final_m[landscape.valid]
    cells = [walk.status if walk.final_m is None else cm(walk.final_m) for walk in findings.defaults(leg)]
    median_m = float(np.median(valid_m)) if valid_m.size else float("nan")
    cells += [cm(median_m), cm(landscape.best_m)]
    for name in findings.plan.optimizers:
        search = findings.searches[leg, name, False]
        found_m = search.best_m[:, after - 1]
        best_m = float(np.nanmin(found_m)) if np.isfinite(found_m).any() else float("nan")
        cells.append(f"{cm(search.curve.median[after - 1])} ({cm(best_m)})")
    return [str(leg), *cells]


def _means(findings: Findings) -> Table:
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    rows = []
    for paper_count in (False, True):
        for name in findings.plan.optimizers:
            curve = findings.mean_curve(name, paper_count=paper_count)
            rows.append([name, "paper's" if paper_count else "fresh", *_curve_cells(curve, shown)])
    return Table(("optimizer", "count", *[f"after {count}" for count in shown]), rows)


def _leg_means(findings: Findings) -> Table:
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    rows = [
        [str(leg), name, *_curve_cells(findings.searches[leg, name, True].curve, shown)]
        for leg in findings.searched
        for name in findings.plan.optimizers
    ]
    return Table(("leg", "optimizer", *[f"after {count}" for count in shown]), rows)


def _curve_cells(curve: Curve, shown: list[int]) -> list[str]:
    return [
        f"{cm(curve.mean[at - 1])} ± {cm(curve.std[at - 1])}{_share(curve.share[at - 1])}" for at in shown
    ]


def _distinct(findings: Findings) -> Table:
    """Codes that each search asks for by itself, and those that the paper's count pays for."""
    rows = []
    for name in findings.plan.optimizers:
        searches = [findings.searches[leg, name, True] for leg in findings.searched]
        cells = [f"{search.own_codes.mean():.0f} / {search.distinct.mean():.0f}" for search in searches]
        rows.append([name, *cells])
    legs = [f"leg {leg}" for leg in findings.searched]
    return Table(("optimizer", *legs), rows)


#: Beginnings of verdicts, and how the summary counts them.
COUNTED = {
    "holds": "hold",
    "does not hold": "do not hold",
    "no evidence": "have no evidence",
    "not judged": "are not judged",
    "not measured": "are not measured",
}


def summary(findings: Findings) -> str:
    """Three sentences for the top of a report."""
    return " ".join((_experiment(findings), _verdicts(findings.claims), _best_search(findings)))


def _experiment(findings: Findings) -> str:
    plan = findings.plan
    legs = f"leg {plan.legs[0]}" if len(plan.legs) == 1 else f"each of {len(plan.legs)} legs"
    search = "one search" if len(plan.optimizers) == 1 else f"{len(plan.optimizers)} searches"
    return (
        f"{plan.robot.name} walked 120 gaits for {plan.duration_s:g} s with {legs} {plan.failure}, "
        f"and {search} looked for the straightest gait."
    )


def _verdicts(claims: Sequence[Claim]) -> str:
    counts = {
        words: sum(claim.verdict.startswith(begin) for claim in claims) for begin, words in COUNTED.items()
    }
    *others, last = [f"{count} {words}" for words, count in counts.items() if count]
    listed = f"{', '.join(others)} and {last}" if others else last
    return f"Of the paper's {len(claims)} claims, {listed}."


def _best_search(findings: Findings) -> str:
    """The best search, the random baseline and the best default gait, in one sentence."""
    after = min(EARLY, findings.plan.budget)
    means_m = {
        name: float(findings.mean_curve(name, paper_count=False).mean[after - 1])
        for name in findings.plan.optimizers
    }
    found = {name: mean_m for name, mean_m in means_m.items() if np.isfinite(mean_m)}
    if not found:
        return f"No search found a valid gait within {after} evaluations."
    best = min(found, key=found.__getitem__)
    parts = [f"{cm(found[best])} with the best search ({best})"]
    if BASELINE in found and best != BASELINE:
        parts.append(f"{cm(found[BASELINE])} with random search")
    parts += _without_a_search(findings)
    listed = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    return f"After {after} evaluations, the mean deviation from the line is {listed}."


def _without_a_search(findings: Findings) -> list[str]:
    """Mean deviation with the best default gait; empty if each of them is invalid for some leg."""
    ends_m: dict[str, list[float | None]] = {}
    for walk in findings.default_walks:
        if walk.leg in findings.searched:
            ends_m.setdefault(walk.gait, []).append(walk.final_m)
    means_m = {
        gait: fmean(final_m for final_m in ends if final_m is not None)
        for gait, ends in ends_m.items()
        if None not in ends
    }
    if not means_m:
        return []
    best = min(means_m, key=means_m.__getitem__)
    return [f"{cm(means_m[best])} with the {best} gait, which needs no search"]


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
