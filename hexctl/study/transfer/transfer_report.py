"""The report of a transfer benchmark: one HTML page, with figures and a table beside it."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.adapt.optimizers.shipped import BAYES
from hexctl.files import atomic_write
from hexctl.palette import BAR_COLOR, BEST_OF_ALL_COLOR, hex_color
from hexctl.study.landscapes.versions import code_versions
from hexctl.study.reports.figure_style import grid_of, label_axes, line_of, new_figure, save_figure
from hexctl.study.reports.report_page import Block, Bullets, Picture, Section, Table, render_page
from hexctl.study.reports.study_tables import number
from hexctl.study.study_plan import BASELINE
from hexctl.study.transfer.transfer_plan import PRIORED
from hexctl.study.transfer.transfer_searches import NEAR_M, NEARER_M, Curves, TransferFindings
from hexctl.study.verdicts.claim_evidence import Bar, cm, too_short
from hexctl.study.verdicts.verdict_uncertainty import StudyUncertainty
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Mean deviation over all worlds and legs, the trials within which it is required, and the stretch goal.
ASKED = ((NEAR_M, 4, 2), (NEARER_M, 12, 6))

#: Most trials that `bayes` may need beyond random search, in any kind of world.
MORE_THAN_RANDOM = 2

#: Required share of outcomes inside their 90 % intervals.
COVERAGE = (0.85, 0.95)


def transfer_bars(findings: TransferFindings) -> list[Bar]:
    """Bars that the benchmark's optimizers and budget reach; none is judged on walks that are too short."""
    if BAYES not in findings.plan.optimizers or not findings.landscapes:
        return []
    bars = [*_means(findings), *_against_random(findings), _coverage(findings)]
    reason = too_short(findings.plan.duration_s)
    return [replace(bar, holds=None, not_judged=reason) for bar in bars] if reason else bars


def _coverage(findings: TransferFindings) -> Bar:
    share, outcomes = findings.coverage(BAYES, findings.places())
    low, high = COVERAGE
    return Bar(
        name="coverage",
        asked=f"{low:.0%} to {high:.0%} of outcomes in their intervals for nine of ten",
        measured=f"{share:.1%} of {outcomes}",
        holds=low <= share <= high,
    )


def _means(findings: TransferFindings) -> Iterator[Bar]:
    curves = findings.by_trials(BAYES, findings.places())
    for bound_m, within, stretch in ASKED:
        if within > findings.plan.budget:
            continue
        needed = curves.trials_to(bound_m)
        yield Bar(
            name=f"mean_{bound_m:g}_m",
            asked=f"mean within {cm(bound_m)} after {within} trials (stretch: {stretch})",
            measured=f"{_trials(needed)}; {cm(float(curves.mean[within - 1]))} after {within}",
            holds=needed is not None and needed <= within,
        )


def _against_random(findings: TransferFindings) -> Iterator[Bar]:
    """Compare with random search, kind by kind, wherever random search gets within the budget."""
    if BASELINE not in findings.plan.optimizers:
        return
    for kind in findings.kinds():
        places = findings.places(kind)
        bayes, random = (findings.by_trials(name, places) for name in (BAYES, BASELINE))
        for bound_m in (NEAR_M, NEARER_M):
            ours, theirs = bayes.trials_to(bound_m), random.trials_to(bound_m)
            if theirs is None and ours is None:
                continue  # out of reach of both
            yield Bar(
                name=f"{kind}_{bound_m:g}_m",
                asked=f"{kind}: mean within {cm(bound_m)}, {MORE_THAN_RANDOM} trials after random at most",
                measured=f"{_trials(ours)}, random {_trials(theirs)}",
                holds=ours is not None and (theirs is None or ours <= theirs + MORE_THAN_RANDOM),
            )


def _trials(count: int | None) -> str:
    return "not within the budget" if count is None else f"after {count}"


#: Points of the curves over seconds.
SECONDS = 120


def trials_figure(findings: TransferFindings) -> "Figure":
    """Mean, median and 90th percentile over trials, of all worlds and legs."""
    figure, panels = new_figure(1, 3, (13.0, 4.6))
    places = findings.places()
    trials = np.arange(1.0, findings.plan.budget + 1)
    for name in findings.plan.optimizers:
        _draw(panels, name, trials, findings.by_trials(name, places))
    _finish(figure, panels, findings, places, "trials", "All worlds and legs, over trials")
    return figure


def seconds_figure(findings: TransferFindings) -> "Figure":
    """Mean, median and 90th percentile over the seconds walked."""
    figure, panels = new_figure(1, 3, (13.0, 4.6))
    places = findings.places()
    seconds = np.linspace(0, findings.plan.budget * findings.plan.duration_s, SECONDS + 1)[1:]
    for name in findings.plan.optimizers:
        _draw(panels, name, seconds, findings.by_seconds(name, places, seconds))
    _finish(figure, panels, findings, places, "seconds walked", "All worlds and legs, over seconds walked")
    return figure


def kinds_figure(findings: TransferFindings) -> "Figure":
    """Means over trials, one panel per kind of world."""
    kinds = findings.kinds()
    rows, columns = grid_of(len(kinds))
    figure, panels = new_figure(rows, columns, (4.6 * columns + 0.6, 3.4 * rows + 0.8))
    trials = np.arange(1.0, findings.plan.budget + 1)
    for panel, kind in zip(panels, kinds, strict=False):
        places = findings.places(kind)
        for name in findings.plan.optimizers:
            _line(panel, name, trials, findings.by_trials(name, places).mean)
        _floor(panel, findings.floor_m(places))
        panel.set_title(f"{kind}, {len(places)} worlds and legs", fontsize=9)
    _label(figure, panels, len(kinds), "trials", "Mean, by the kind of world")
    return figure


def _draw(panels: "list[Axes]", name: str, across: FloatArray, curves: Curves) -> None:
    for panel, values in zip(panels, (curves.mean, curves.median, curves.p90), strict=True):
        _line(panel, name, across, values)


def _line(panel: "Axes", name: str, across: FloatArray, values: FloatArray) -> None:
    strong = name.startswith("bayes")
    panel.plot(across, values, linewidth=2.2 if strong else 1.1, label=name, **line_of(name))


def _floor(panel: "Axes", floor_m: float) -> None:
    panel.axhline(
        floor_m, color=hex_color(BEST_OF_ALL_COLOR), linewidth=1.2, linestyle=":", label="best of all gaits"
    )


def _finish(
    figure: "Figure",
    panels: "list[Axes]",
    findings: TransferFindings,
    places: list[int],
    across: str,
    title: str,
) -> None:
    for panel, what in zip(panels, ("mean", "median", "nine of ten are below"), strict=True):
        _floor(panel, findings.floor_m(places))
        panel.set_title(f"{what};  best of all gaits {cm(findings.floor_m(places))}", fontsize=9)
    _label(figure, panels, 3, across, title)


def _label(figure: "Figure", panels: "list[Axes]", used: int, across: str, title: str) -> None:
    """Give all panels a logarithmic scale and labels, and the figure one legend."""
    for panel in panels[:used]:
        panel.set_yscale("log")
        for bound_m in (NEAR_M, NEARER_M):
            panel.axhline(bound_m, color=hex_color(BAR_COLOR), linewidth=0.5)
        panel.set_yticks([0.01, 0.025, 0.1, 0.5, 1.0], ["1 cm", "2.5 cm", "10 cm", "50 cm", "1 m"])
        panel.minorticks_off()
    label_axes(panels, used, across, "deviation of the best gait so far")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9, frameon=False)
    figure.suptitle(title, fontsize=11)


REPORT = "transfer.html"
TABLE = "transfer.parquet"

#: Trials at which tables show the curves, as far as the budget goes.
SHOWN = (1, 2, 3, 4, 6, 8, 10, 15, 20, 40, 60)

READING = (
    "Deviation of the best gait found so far, as the landscape has it: every gait of every world and leg was "
    "walked, and searches look their trials up.",
    "A search that has found no valid gait yet counts with the worst valid gait of its landscape.",
    "bayes stops when it is sure of its target; its curve is flat from there on.",
    "bayes-early ends a walk once its outcome is known well enough: it learns less per trial and more per "
    "second.",
    "The worlds are drawn from wider ranges than the prior's, and every other one is of a kind that no world "
    "of the prior is. Earlier worlds of the same family were used while bayes was developed, these never "
    "were; the other searches have the paper's parameters.",
    "Trials have no noise here: a repeat gives the same end. That bayes is sure says that it measured a gait "
    "within its target; how it does under noise is not told by this page.",
    "Outcomes in intervals: each gait's first walk, where it was walked out; walks that were cut short are "
    "not among them.",
    "Seconds are of walking; settling, self-rotation and stopping come on top, some 12 s a trial.",
    "The legs of one world are correlated: a kind with 3 worlds has 18 curves, but only 3 worlds. The "
    "standard error of a mean counts worlds, not curves.",
)

_FIGURES = (("over_trials", trials_figure), ("over_seconds", seconds_figure), ("kinds", kinds_figure))


def write_transfer_report(findings: TransferFindings, uncertainty: StudyUncertainty, folder: Path) -> Path:
    """Write table, figures and the report into a folder; path of the report."""
    _write_table(findings, folder)
    drawn = [(name, _drawn(draw(findings), folder, name)) for name, draw in _FIGURES]
    path = folder / REPORT
    sections = [*_verdicts(findings, uncertainty), *_pictures(drawn), *_numbers(findings)]
    heading = "Adaptation in worlds outside every prior"
    atomic_write(path, render_page("hexctl study --transfer", heading, sections))
    return path


def transfer_json(findings: TransferFindings, uncertainty: StudyUncertainty) -> dict[str, Any]:
    """Settings and results of a benchmark as JSON values."""
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
        "uncertainty": uncertainty.as_json(),
        "code": code_versions(),
        "landscapes": len(findings.landscapes),
        "landscapes_without_valid_gait": findings.without,
        "best_of_all_m": number(findings.floor_m(places)),
        "best_of_all_standard_error_m": number(findings.floor_error_m(places)),
        "reachable": {f"{bound:g}": len(findings.places(reachable_m=bound)) for bound in (NEAR_M, NEARER_M)},
        "bars": [bar.as_json() for bar in transfer_bars(findings)],
        "optimizers_found": {name: _found(findings, name, places) for name in plan.optimizers},
    }


def _found(findings: TransferFindings, name: str, places: list[int]) -> dict[str, Any]:
    curves = findings.by_trials(name, places)
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    share, outcomes = findings.coverage(name, places)
    error_m = findings.standard_error_m(name, places)
    return {
        **{
            f"{what}_m": {str(count): number(getattr(curves, what)[count - 1]) for count in shown}
            for what in ("mean", "median", "p90")
        },
        "standard_error_m": {str(count): number(error_m[count - 1]) for count in shown},
        "trials_to": {f"{bound:g}": curves.trials_to(bound) for bound in (NEAR_M, NEARER_M)},
        "walked_s": number(_walked_s(findings, name, places)),
        "coverage": number(share),
        "outcomes": outcomes,
    }


def _verdicts(findings: TransferFindings, uncertainty: StudyUncertainty) -> Iterator[Section]:
    plan = findings.plan
    settings = (
        f"Robot {plan.robot.name}; legs {', '.join(str(leg) for leg in plan.legs)} locked, self-rotation "
        f"rear, {plan.duration_s:g} s a trial; {plan.worlds} worlds; {plan.budget} trials; {plan.runs} runs "
        f"of each search that has a seed; prior of {plan.prior.worlds} worlds a leg; "
        f"target {cm(plan.target_m)}."
    )
    yield Section("", [settings, uncertainty.sentence])
    rows = [(bar.asked, bar.measured, bar.verdict) for bar in transfer_bars(findings)]
    yield Section("Bars", [Table(("asked", "measured", "verdict"), rows)])
    yield Section("How to read this", [Bullets(READING), _reach(findings)])


def _pictures(drawn: list[tuple[str, Path]]) -> Iterator[Section]:
    here = "Red lines: 10 cm and 2.5 cm. The scale is logarithmic."
    for name, file in drawn:
        picture = Picture(file, "Not in the paper.", here)
        yield Section(name.replace("_", " ").capitalize(), [picture])


def _numbers(findings: TransferFindings) -> Iterator[Section]:
    yield Section("All worlds and legs", _curves(findings, findings.places()))
    near = findings.places(reachable_m=NEARER_M)
    yield Section("Where some gait is within 2.5 cm", _curves(findings, near))
    for kind in findings.kinds():
        yield Section(f"Kind {kind}", _curves(findings, findings.places(kind)))
    yield Section("How sure bayes was", [_sure_table(findings)])
    yield Section("Versions", [", ".join(f"{name} {value}" for name, value in code_versions().items())])


def _reach(findings: TransferFindings) -> str:
    total = len(findings.landscapes)
    within = [len(findings.places(reachable_m=bound)) for bound in (NEAR_M, NEARER_M)]
    places = findings.places()
    floor = _with_error(findings.floor_m(places), findings.floor_error_m(places))
    return (
        f"Best of all gaits: {floor} on the mean. Of {total} worlds and legs {within[0]} have a valid gait "
        f"within 10 cm and {within[1]} one within 2.5 cm; {findings.without} more have no valid gait at all "
        "and are left out."
    )


def _curves(findings: TransferFindings, places: list[int]) -> list[Block]:
    shown = [count for count in SHOWN if count <= findings.plan.budget]
    rows = []
    for name in findings.plan.optimizers:
        if not places:
            continue
        curves = findings.by_trials(name, places)
        error_m = findings.standard_error_m(name, places)
        means = [_with_error(curves.mean[count - 1], error_m[count - 1]) for count in shown]
        rows.append([f"{name}, mean", *means])
        for what in ("median", "p90"):
            values = getattr(curves, what)
            rows.append([f"{name}, {what}", *[cm(float(values[count - 1])) for count in shown]])
    floor = _with_error(findings.floor_m(places), findings.floor_error_m(places)) if places else "-"
    note = f"{len(places)} worlds and legs; best of all gaits {floor}. Means ± standard error over worlds."
    return [note, Table(("deviation", *[f"after {count}" for count in shown]), rows)]


def _with_error(mean_m: float, error_m: float) -> str:
    """A mean with its standard error, where that is known."""
    return cm(mean_m) + (f" ± {cm(error_m)}" if np.isfinite(error_m) else "")


def _sure_table(findings: TransferFindings) -> Table:
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
    return Table(header, rows)


def _walked_s(findings: TransferFindings, name: str, places: list[int]) -> float:
    """Mean walking time of a run, in s."""
    return float(
        np.mean([course.walked_s[-1] for place in places for course in findings.courses[place, name]])
    )


def _drawn(drawn: "Figure", folder: Path, name: str) -> Path:
    return save_figure(drawn, folder, f"transfer_{name}")


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
