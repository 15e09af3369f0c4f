"""The report of the paper's study: sections of the page, tables and JSON, all from the same frames."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.control.assessment.uncertainty_store import known_uncertainty
from hexctl.robot.configs import config_root
from hexctl.study.data_frames import json_value, records, where
from hexctl.study.experiment import plain
from hexctl.study.landscape import NUMBERS, Landscape
from hexctl.study.paper.claims import LATE_ABOVE_BEST_M, bars_of, expected_best_rank
from hexctl.study.paper.evidence import EARLY, EARLY_M, LATE, LATE_M, Claim, cm, limit_text
from hexctl.study.paper.searches import ALL, FRESH, NULL_DRAWS, PAPER, Findings
from hexctl.study.paper.study_settings import BASELINE
from hexctl.study.report_page import Block, Bullets, Fold, Picture, Section, Table, reading, texts
from hexctl.study.versions import code_versions

if TYPE_CHECKING:
    from pandas import DataFrame

#: Numbers of evaluations at which tables show the curves, up to the budget.
SHOWN = (1, 10, 20, 40, 60, 120)

#: Beginnings of verdicts, and how the summary counts them.
COUNTED = {
    "holds": "hold",
    "does not hold": "do not hold",
    "no evidence": "have no evidence",
    "not judged": "are not judged",
    "not measured": "are not measured",
}


def landscapes_of(findings: Findings) -> "DataFrame":
    """Return the landscapes of the first world in numbers, a row for each."""
    from pandas import DataFrame

    return DataFrame(
        {
            "leg": leg,
            "self_rotation": rotation,
            "gaits": len(landscape.codes),
            "valid": int(landscape.valid.sum()),
            "left_share": landscape.left_share,
            "within_0.10_m": landscape.within(EARLY_M),
            "within_0.025_m": landscape.within(LATE_M),
            "best_m": landscape.best_m,
        }
        for (world, leg, rotation), landscape in findings.landscapes.items()
        if not world
    )


def study_json(findings: Findings) -> dict[str, Any]:
    """Return settings and results of a study as JSON values; null if there is no number."""
    plan, bars = findings.plan, bars_of(findings)
    names = (
        "legs",
        "optimizers",
        "runs",
        "budget",
        "duration_s",
        "seed",
        "failure",
        "self_rotation",
        "worlds",
    )
    walks = findings.default_walks
    return {
        "robot": plan.robot.name,
        "world": plan.world.model_dump(mode="json"),
        **plain(plan, *names),
        "uncertainty": findings.uncertainty.as_json(),
        "code": code_versions(),
        "claims": [{**asdict(claim), "verdict": claim.verdict} for claim in findings.claims],
        "bars": [
            row | {"leg": row["leg"] or None} for row in records(bars.drop(columns=["over_m", "verdict"]))
        ],
        "landscapes": records(landscapes_of(findings)),
        "default_gaits": [] if walks is None else records(walks),
        "convergence": [
            _curve_json(findings, name, count) for count in (FRESH, PAPER) for name in plan.optimizers
        ],
    }


def _curve_json(findings: Findings, optimizer: str, count: str) -> dict[str, Any]:
    curve = findings.curves[ALL, optimizer, count].loc[_shown(findings)]
    codes = _codes(where(findings.first_runs, optimizer=optimizer, count=count))
    return {
        "optimizer": optimizer,
        "count": count,
        **{
            name: {str(at): json_value(value) for at, value in curve[name].items()}
            for name in ("mean_m", "std_m", "share_of_runs")
        },
        "distinct_codes": codes["distinct"].astype(int).to_list(),
        "own_codes_until_stuck": codes["own"].round(1).to_list(),
    }


def _shown(findings: Findings) -> list[int]:
    return [count for count in SHOWN if count <= findings.plan.budget]


def _codes(runs: "DataFrame") -> "DataFrame":
    """Mean numbers of codes that the runs of each leg ask for by themselves, and of distinct ones."""
    distinct = [np.unique(codes[codes > 0]).size for codes in runs["codes"]]
    counted = runs[["leg"]].assign(own=runs["own_codes"], distinct=distinct)
    return counted.groupby("leg").mean()


def study_tables(findings: Findings) -> "dict[str, DataFrame]":
    """Return landscapes (a row per gait), convergence (per evaluation) and runs (per run and evaluation)."""
    from pandas import concat

    head = ["leg", "optimizer", "count"]
    curves = {key: curve for key, curve in findings.curves.items() if key[0] != ALL}
    runs = findings.first_runs[[*head, "seed", "codes", "scores", "best_m"]]
    runs = runs.rename(columns={"codes": "code", "scores": "score"})
    long = runs.assign(evaluation=[range(1, findings.plan.budget + 1)] * len(runs))
    long = long.explode(["evaluation", "code", "score", "best_m"])
    types = {"evaluation": int, "code": int, "score": float, "best_m": float}
    walked = [one for (world, *_), one in findings.landscapes.items() if not world]
    return {
        "landscapes": concat([_gaits(landscape) for landscape in walked]),
        "convergence": concat(curves, names=[*head, "evaluation"]).reset_index(),
        "runs": long[[*head, "seed", "evaluation", "code", "score", "best_m"]].astype(types),
    }


def _gaits(landscape: Landscape) -> "DataFrame":
    from pandas import DataFrame

    spec = landscape.spec
    paths = [path[np.isfinite(path[:, 0])] for path in landscape.paths_m]
    return DataFrame(
        {
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
    )


def study_sections(findings: Findings, pictures: Mapping[str, Picture]) -> Iterator[Section]:
    """Return the parts of the report of a study."""
    world = findings.plan.world.model_dump()
    values = [(name, str(value)) for name, value in world.items() if name != "sensor_noise"]
    parameters = Fold("Parameters of the world", Table(("parameter", "value"), values))
    yield Section("", [summary(findings), _settings(findings), findings.uncertainty.sentence, parameters])
    header = ("claim of the paper", "holds here if", "measured here", "for comparison", "verdict")
    rows = [(one.claim, one.rule, one.measured, _beside(one), one.verdict) for one in findings.claims]
    yield Section("Claims of the paper", [Table(header, rows)])
    ranks = {"early": expected_best_rank(EARLY), "late": expected_best_rank(LATE)}
    yield reading("study", Bullets([_stuck(findings)]), draws=NULL_DRAWS, **ranks)
    left_open = (
        "What the paper leaves open, and how it is read here; numbers are those of ant on the flat "
        "floor, leg locked, after the turn."
    )
    yield Section("Assumptions", [left_open, assumptions()])
    yield Section("The bar: mean over legs and runs", _bar_blocks(findings))
    if findings.default_walks is not None:
        yield Section("Without a search", [texts("default_gaits"), _defaults(findings)])
    for name, picture in pictures.items():
        yield Section(name.replace("_", " ").capitalize(), [picture])
    yield Section("Landscapes", [_landscapes(findings)])
    yield Section("Means over all legs and runs, with standard deviation", [_means(findings)])
    title = "Means of each leg over its runs, with standard deviation, by the paper's count"
    yield Section(title, [_leg_means(findings)])
    distinct = (
        "Mean over runs: new codes until the search is stuck / different codes that the paper's count buys."
    )
    yield Section("Distinct codes", [distinct, _distinct(findings)])


def assumptions() -> Table:
    """Return what the paper leaves open, and how hexctl reads it.

    The last row has the simulation's uncertainty of the shipped `ant`.
    """
    header = ("to decide", "the paper", "hexctl", "read otherwise")
    *rows, last = (list(one.values()) for one in texts("assumptions"))
    return Table(header, [*rows, [*last[:-1], f"{last[-1]} {_uncertainty_text()}"]])


def _uncertainty_text() -> str:
    """Changes of the ends of walks with the numerical settings, from `configs/uncertainty.yaml`."""
    known = known_uncertainty("ant", folder=config_root())
    if known is None:
        return "What another step would change was not measured."
    return (
        f"Half the step moves ends by {cm(known.step_m)}, MuJoCo's own solver tolerance by "
        f"{cm(known.solver_m)}, contacts a third softer or harder by {cm(known.contact_m)} (rms of "
        f"{known.walks} walks)."
    )


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
    means = {
        name: _codes(where(findings.first_runs, optimizer=name, count=PAPER))["own"]
        for name in findings.heuristics
    }
    each = ", ".join(f"{name} after {own.min():.0f} to {own.max():.0f}" for name, own in means.items())
    return (
        f"Distinct codes until a search is stuck, means of the runs of each leg: {each or 'none searched'}."
    )


def _beside(claim: Claim) -> str:
    null = f"random numbers: {claim.null}" if claim.null else ""
    symmetric = f"symmetry: {claim.symmetric}" if claim.symmetric else ""
    return "; ".join(text for text in (claim.beside, symmetric, null) if text)


def _bar_blocks(findings: Findings) -> list[Block]:
    late = limit_text(LATE_M)
    bar = (
        f"{limit_text(EARLY_M)} within {EARLY} evaluations; within {LATE}, {late}, or, for a leg whose best "
        f"gait of all is above {late}, {limit_text(LATE_ABOVE_BEST_M)} more than that gait. Next to it the "
        "random baseline, which has to hold it too."
    )
    bars = bars_of(findings)
    fresh, paper = (_bars(where(bars, count=count)) for count in (FRESH, PAPER))
    return [bar, "Each gait paid for once:", fresh, "By the paper's count:", paper]


def _bars(bars: "DataFrame") -> Table:
    header, rows = ["optimizer", "evaluations", "bar", "mean", "verdict"], []
    for (optimizer, evaluations), some in bars.groupby(["optimizer", "evaluations"], sort=False):
        together, *legs = some.to_dict("records")
        mean = cm(together["mean_m"]) + _share(together["share_of_runs"])
        head = [optimizer, str(evaluations), cm(together["limit_m"]), mean, together["verdict"]]
        rows.append([*head, *map(_leg_cell, legs)])
        header[5:] = [f"leg {one['leg']}" for one in legs]
    return Table(header, rows)


def _leg_cell(row: Mapping[str, Any]) -> str:
    over = f" (+{cm(row['over_m'])})" if row["holds"] is False else ""
    return cm(row["mean_m"]) + over + _share(row["share_of_runs"])


def _share(share: float) -> str:
    return "" if share == 1 else f" [{share:.0%} of the runs]"


def _landscapes(findings: Findings) -> Table:
    header = ("leg", "self-rotation", "gaits", "valid", "end left", "within 10 cm", "within 2.5 cm", "best")
    texts = {"left_share": "{:.0%}".format, "best_m": findings.uncertainty.beside}
    rows = [
        [texts.get(name, str)(value) for name, value in row.items()]
        for row in landscapes_of(findings).to_dict("records")
    ]
    return Table(header, rows)


def _defaults(findings: Findings) -> Table:
    walks = findings.default_walks
    assert walks is not None  # noqa: S101  there is no such section without them
    after = min(EARLY, findings.plan.budget)
    searches = [f"{name} after {after}" for name in findings.plan.optimizers]
    header = ("leg", *walks["gait"].unique(), "median of all valid gaits", "best of all gaits", *searches)
    rows = []
    for leg in findings.searched:
        landscape = findings.rotated(leg)
        valid_m = landscape.final_m[landscape.valid]
        own = [default_text(walk) for walk in where(walks, leg=leg).itertuples()]
        median_m = float(np.median(valid_m)) if valid_m.size else float("nan")
        found = [_found_text(findings, leg, name, after) for name in findings.plan.optimizers]
        rows.append([str(leg), *own, cm(median_m), cm(landscape.best_m), *found])
    return Table(header, rows)


def default_text(walk: Any) -> str:
    """Return the end of a walk with a default gait in words, or its status if it is invalid."""
    return cm(walk.final_m) if np.isfinite(walk.final_m) else walk.status


def _found_text(findings: Findings, leg: int, optimizer: str, after: int) -> str:
    runs = where(findings.first_runs, leg=leg, optimizer=optimizer, count=FRESH)
    found_m = np.array([best_m[after - 1] for best_m in runs["best_m"]])
    best_m = float(np.nanmin(found_m)) if np.isfinite(found_m).any() else float("nan")
    median_m = findings.curves[leg, optimizer, FRESH]["median_m"][after]
    return f"{cm(median_m)} ({cm(best_m)})"


def _means(findings: Findings) -> Table:
    names = {FRESH: "fresh", PAPER: "paper's"}
    keys = [(ALL, name, count) for count in names for name in findings.plan.optimizers]
    return _curve_table(findings, {"optimizer": lambda key: key[1], "count": lambda key: names[key[2]]}, keys)


def _leg_means(findings: Findings) -> Table:
    keys = [(leg, name, PAPER) for leg in findings.searched for name in findings.plan.optimizers]
    return _curve_table(findings, {"leg": lambda key: str(key[0]), "optimizer": lambda key: key[1]}, keys)


def _curve_table(
    findings: Findings, head: Mapping[str, Callable[[Any], str]], keys: Sequence[tuple[int, str, str]]
) -> Table:
    """A row for each curve, with mean, standard deviation and share of the runs at the shown evaluations."""

    def text(key: tuple[int, str, str], after: int) -> str:
        at = findings.curves[key].loc[after]
        return f"{cm(at['mean_m'])} ± {cm(at['std_m'])}{_share(at['share_of_runs'])}"

    cells = {f"after {after}": partial(text, after=after) for after in _shown(findings)}
    return Table.of(keys, {**head, **cells})


def _distinct(findings: Findings) -> Table:
    """Codes that each search asks for by itself, and those that the paper's count pays for."""
    rows = []
    for name in findings.plan.optimizers:
        codes = _codes(where(findings.first_runs, optimizer=name, count=PAPER))
        rows.append([name, *[f"{one.own:.0f} / {one.distinct:.0f}" for one in codes.itertuples()]])
    return Table(("optimizer", *[f"leg {leg}" for leg in findings.searched]), rows)


def summary(findings: Findings) -> str:
    """Return three sentences for the top of a report."""
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
    listed = _listed([f"{count} {words}" for words, count in counts.items() if count])
    return f"Of the paper's {len(claims)} claims, {listed}."


def _listed(parts: Sequence[str]) -> str:
    *others, last = parts
    return f"{', '.join(others)} and {last}" if others else last


def _best_search(findings: Findings) -> str:
    after = min(EARLY, findings.plan.budget)
    means_m = {name: findings.curves[ALL, name, FRESH]["mean_m"][after] for name in findings.plan.optimizers}
    found = {name: mean_m for name, mean_m in means_m.items() if np.isfinite(mean_m)}
    if not found:
        return f"No search found a valid gait within {after} evaluations."
    best = min(found, key=found.__getitem__)
    parts = [f"{cm(found[best])} with the best search ({best})"]
    if BASELINE in found and best != BASELINE:
        parts.append(f"{cm(found[BASELINE])} with random search")
    parts += _without_a_search(findings)
    return f"After {after} evaluations, the mean deviation from the line is {_listed(parts)}."


def _without_a_search(findings: Findings) -> list[str]:
    """Mean deviation with the best default gait; empty if each is invalid for some leg."""
    walks = findings.default_walks
    if walks is None:
        return []
    searched = walks[walks["leg"].isin(findings.searched)]
    means_m = (
        searched.groupby("gait", sort=False)["final_m"].agg(lambda ends: ends.mean(skipna=False)).dropna()
    )
    if means_m.empty:
        return []
    return [f"{cm(means_m.min())} with the {means_m.idxmin()} gait, which needs no search"]
