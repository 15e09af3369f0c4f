"""The report of a transfer benchmark: one page, with figures and tables beside it."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.study.claim import cm
from hexctl.study.drawing import save_figure
from hexctl.study.html import bullets, figure, heading, page, paragraph, table
from hexctl.study.summary import number
from hexctl.study.transfer.bars import transfer_bars
from hexctl.study.transfer.figures import kinds_figure, seconds_figure, trials_figure
from hexctl.study.transfer.findings import NEAR_M, NEARER_M, TransferFindings
from hexctl.study.transfer.plan import PRIORED
from hexctl.study.versions import code_versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT = "transfer.html"
TABLE = "transfer.parquet"

#: Trials at which tables show the curves, as far as the budget goes.
SHOWN = (1, 2, 3, 4, 6, 8, 10, 15, 20, 40, 60)

READING = (
    "Deviation of the best gait found so far, as the landscape has it: every gait of every world and leg was "
    "walked, and searches look their trials up.",
    "A search that has found no valid gait yet counts with the worst valid gait of its landscape.",
    "bayes stops when it is sure of its target; its curve goes on flat from there.",
    "bayes-early ends a walk once its outcome is known well enough; over trials it therefore sees less, over "
    "seconds it gets on faster.",
    "The worlds are drawn from wider ranges than the prior's, and every other one is of a kind that no world "
    "of the prior is. Earlier worlds of the same family were looked at while bayes was made, these never "
    "were; the other searches have the paper's parameters.",
    "Trials have no noise here: a repeat gives the same end. That bayes is sure says that it measured a gait "
    "within its target; how it does under noise is not told by this page.",
    "Outcomes in intervals: each gait's first walk, where it was walked out; walks that were cut short are "
    "not among them.",
    "Seconds are of walking; settling, self-rotation and stopping come on top, some 12 s a trial.",
    "The legs of one world are correlated: a kind with 3 worlds has 18 curves, but only 3 worlds.",
)

_FIGURES = (("over_trials", trials_figure), ("over_seconds", seconds_figure), ("kinds", kinds_figure))


def write_transfer_report(findings: TransferFindings, folder: Path) -> Path:
    """Write table, figures and the report into a folder, and return the report's path."""
    _write_table(findings, folder)
    drawn = [(name, _drawn(draw(findings), folder, name)) for name, draw in _FIGURES]
    path = folder / REPORT
    temporary = path.with_suffix(".html.part")
    temporary.write_text(page("hexctl study --transfer", _parts(findings, drawn)), encoding="utf-8")
    temporary.replace(path)
    return path


def transfer_json(findings: TransferFindings) -> dict[str, Any]:
    """Return what was asked and found as JSON values."""
    plan, places = findings.plan, findings.places()
    return {
        "robot": plan.robot.name,
        "worlds": plan.worlds,
        "legs": list(plan.legs),
        "optimizers": list(plan.optimizers),
        "runs": plan.runs,
        "budget": plan.budget,
        "duration_s": plan.duration_s,
        "target_m": plan.target_m,
        "code": code_versions(),
        "landscapes": len(findings.landscapes),
        "landscapes_without_valid_gait": findings.without,
        "best_of_all_m": number(findings.floor_m(places)),
        "reachable": {f"{bound:g}": len(findings.places(reachable_m=bound)) for bound in (NEAR_M, NEARER_M)},
        "bars": [bar.as_json() for bar in transfer_bars(findings)],
        "optimizers_found": {name: _found(findings, name, places) for name in plan.optimizers},
    }


def _found(findings: TransferFindings, name: str, places: list[int]) -> dict[str, Any]:
    curves = findings.by_trials(name, places)
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    share, outcomes = findings.coverage(name, places)
    return {
        **{
            f"{what}_m": {str(count): number(getattr(curves, what)[count - 1]) for count in shown}
            for what in ("mean", "median", "p90")
        },
        "trials_to": {f"{bound:g}": curves.trials_to(bound) for bound in (NEAR_M, NEARER_M)},
        "walked_s": number(_walked_s(findings, name, places)),
        "coverage": number(share),
        "outcomes": outcomes,
    }


def _parts(findings: TransferFindings, drawn: list[tuple[str, Path]]) -> Iterator[str]:
    plan, places = findings.plan, findings.places()
    yield heading("Adaptation in worlds that nobody simulated before", 1)
    yield paragraph(
        f"Robot {plan.robot.name}; legs {', '.join(str(leg) for leg in plan.legs)} locked, self-rotation "
        f"rear, {plan.duration_s:g} s a trial; {plan.worlds} worlds; {plan.budget} trials; {plan.runs} runs "
        f"of each search that has a seed; prior of {plan.prior.worlds} worlds a leg; "
        f"target {cm(plan.target_m)}."
    )
    yield heading("Bars")
    yield table(
        ("asked", "measured", "verdict"),
        [(bar.asked, bar.measured, bar.verdict) for bar in transfer_bars(findings)],
    )
    yield heading("How to read this")
    yield bullets(READING)
    yield paragraph(_reach(findings))
    for name, image in drawn:
        yield heading(name.replace("_", " ").capitalize())
        yield figure(image, "Not in the paper.", "Red lines: 10 cm and 2.5 cm. The scale is logarithmic.")
    yield heading("All worlds and legs")
    yield _curves_table(findings, places)
    yield heading("Where some gait is within 2.5 cm")
    yield _curves_table(findings, findings.places(reachable_m=NEARER_M))
    for kind in findings.kinds():
        yield heading(f"Kind {kind}")
        yield _curves_table(findings, findings.places(kind))
    yield heading("How sure bayes was")
    yield _sure_table(findings)
    yield heading("Versions")
    yield paragraph(", ".join(f"{name} {value}" for name, value in code_versions().items()))


def _reach(findings: TransferFindings) -> str:
    total = len(findings.landscapes)
    within = [len(findings.places(reachable_m=bound)) for bound in (NEAR_M, NEARER_M)]
    floor = cm(findings.floor_m(findings.places()))
    return (
        f"Best of all gaits: {floor} on the mean. Of {total} worlds and legs {within[0]} have a valid gait "
        f"within 10 cm and {within[1]} one within 2.5 cm; {findings.without} more have no valid gait at all "
        "and are left out."
    )


def _curves_table(findings: TransferFindings, places: list[int]) -> str:
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    rows = []
    for name in findings.plan.optimizers:
        if not places:
            continue
        curves = findings.by_trials(name, places)
        for what in ("mean", "median", "p90"):
            values = getattr(curves, what)
            rows.append([f"{name}, {what}", *[cm(float(values[count - 1])) for count in shown]])
    note = (
        f"{len(places)} worlds and legs; best of all gaits {cm(findings.floor_m(places)) if places else '-'}."
    )
    return paragraph(note) + table(("deviation", *[f"after {count}" for count in shown]), rows)


def _sure_table(findings: TransferFindings) -> str:
    places = findings.places()
    rows = []
    for name in (name for name in findings.plan.optimizers if name in PRIORED):
        share, outcomes = findings.coverage(name, places)
        sure, trials = findings.sure_share(name, places)
        by_kind = ", ".join(
            f"{kind} {findings.coverage(name, findings.places(kind))[0]:.0%}" for kind in findings.kinds()
        )
        walked = f"{_walked_s(findings, name, places):.0f} s"
        rows.append([name, f"{share:.1%} of {outcomes}", f"{sure:.0%}", f"{trials:.1f}", walked, by_kind])
    header = ("", "outcomes in their 90 % interval", "ended sure", "after trials", "walked", "by kind")
    return table(header, rows)


def _walked_s(findings: TransferFindings, name: str, places: list[int]) -> float:
    """Return how many seconds a run walked on the mean."""
    return float(
        np.mean([course.walked_s[-1] for place in places for course in findings.courses[place, name]])
    )


def _drawn(drawn: "Figure", folder: Path, name: str) -> Path:
    save_figure(drawn, folder, f"transfer_{name}")
    return folder / f"transfer_{name}.png"


def _write_table(findings: TransferFindings, folder: Path) -> None:
    """Write a row for each trial of each run."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    parts = []
    for (place, name), courses in findings.courses.items():
        spec = findings.landscapes[place].spec
        for run, course in enumerate(courses):
            trials = len(course.codes)
            parts.append(
                pa.table(
                    {
                        "world": [spec.seed] * trials,
                        "kind": [findings.plan.kind_of(spec)] * trials,
                        "leg": [spec.leg] * trials,
                        "optimizer": [name] * trials,
                        "run": [run] * trials,
                        "trial": np.arange(1, trials + 1),
                        "code": course.codes,
                        "best_m": course.best_m[:trials],
                        "walked_s": course.walked_s[:trials],
                    }
                )
            )
    pq.write_table(pa.concat_tables(parts), folder / TABLE)
