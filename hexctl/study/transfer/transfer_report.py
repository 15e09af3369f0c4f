"""The report of the transfer benchmark: bars, figures and tables of the runs of its searches."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.adapt.optimizers.shipped import BAYES
from hexctl.study.evidence import (
    EARLY_M,
    LATE_M,
    Bar,
    StudyUncertainty,
    bar_lines,
    cm,
    cm_with_error,
    judged_bars,
)
from hexctl.study.experiment import Drawing, plain
from hexctl.study.figure_style import draw_best_of_all, finish_curves, grid_of, line_of, new_figure
from hexctl.study.frames import json_value
from hexctl.study.report_page import Block, Picture, Section, Table, reading
from hexctl.study.study_settings import BASELINE
from hexctl.study.transfer.transfer_searches import (
    PRIORED,
    Curves,
    by_seconds,
    by_trials,
    coverage,
    floor_m,
    standard_error_m,
    sure_share,
    walked_s,
)
from hexctl.study.versions import code_versions
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from hexctl.study.transfer.transfer_plan import TransferPlan

#: Mean deviation over all worlds and legs, the trials within which it is required, and the stretch goal.
ASKED = ((EARLY_M, 4, 2), (LATE_M, 12, 6))

#: Most trials that `bayes` may need beyond random search, in any kind of world.
MORE_THAN_RANDOM = 2

#: Required share of outcomes inside their 90 % intervals.
COVERAGE = (0.85, 0.95)


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferFound:
    """The results of one benchmark.

    Attributes:
        runs: a row for each run of a search, as `search_worlds` returns them.
        without: number of landscapes without a valid gait, which are left out.
        uncertainty: the simulation's own, of the walks.
    """

    plan: "TransferPlan"
    runs: "DataFrame"
    without: int = 0
    uncertainty: StudyUncertainty = field(default_factory=StudyUncertainty)

    def of(self, optimizer: str, kind: str | None = None) -> "DataFrame":
        """Return the runs of an optimizer, in all worlds or those of a kind."""
        return of(self.runs if kind is None else of(self.runs, kind=kind), optimizer=optimizer)

    def reachable(self, bound_m: float) -> "DataFrame":
        """Return the runs in landscapes whose best gait is within a bound."""
        return self.runs[self.runs["best_of_all_m"] <= bound_m]

    @property
    def kinds(self) -> list[str]:
        """Kinds of worlds, in the order of their first appearance."""
        return list(self.runs["kind"].unique())


def of(runs: "DataFrame", **values: object) -> "DataFrame":
    """Return the runs in which a column has a value."""
    ((column, value),) = values.items()
    return runs[runs[column] == value]


def places(runs: "DataFrame") -> int:
    """Return the number of landscapes."""
    return int(runs["place"].nunique())


def transfer_bars(found: TransferFound) -> list[Bar]:
    """Bars that the benchmark's optimizers and budget reach; none is judged on walks that are too short."""
    if BAYES not in found.plan.optimizers:
        return []
    bars = [*_means(found), *_against_random(found), _coverage(found)]
    return judged_bars(bars, found.plan.duration_s)


def _coverage(found: TransferFound) -> Bar:
    share, outcomes = coverage(found.of(BAYES))
    low, high = COVERAGE
    return Bar(
        name="coverage",
        asked=f"{low:.0%} to {high:.0%} of outcomes in their intervals for nine of ten",
        measured=f"{share:.1%} of {outcomes}",
        holds=low <= share <= high,
    )


def _means(found: TransferFound) -> Iterator[Bar]:
    curves = by_trials(found.of(BAYES))
    for bound_m, within, stretch in ASKED:
        if within > found.plan.budget:
            continue
        needed = curves.trials_to(bound_m)
        yield Bar(
            name=f"mean_{bound_m:g}_m",
            asked=f"mean within {cm(bound_m)} after {within} trials (stretch: {stretch})",
            measured=f"{_trials(needed)}; {cm(float(curves.mean[within - 1]))} after {within}",
            holds=needed is not None and needed <= within,
        )


def _against_random(found: TransferFound) -> Iterator[Bar]:
    """Compare with random search, kind by kind, wherever random search gets within the budget."""
    if BASELINE not in found.plan.optimizers:
        return
    for kind in found.kinds:
        bayes, random = (by_trials(found.of(name, kind)) for name in (BAYES, BASELINE))
        for bound_m in (EARLY_M, LATE_M):
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

#: What the figures show.
UP = "deviation of the best gait so far"


def trials_figure(found: TransferFound) -> "Figure":
    """Mean, median and 90th percentile over trials, of all worlds and legs."""
    trials = np.arange(1.0, found.plan.budget + 1)
    curves = {name: by_trials(found.of(name)) for name in found.plan.optimizers}
    return _curves_figure(found, curves, trials, "trials")


def seconds_figure(found: TransferFound) -> "Figure":
    """Mean, median and 90th percentile over the seconds walked."""
    seconds = np.linspace(0, found.plan.budget * found.plan.duration_s, SECONDS + 1)[1:]
    curves = {name: by_seconds(found.of(name), seconds) for name in found.plan.optimizers}
    return _curves_figure(found, curves, seconds, "seconds walked")


def _curves_figure(
    found: TransferFound, curves: Mapping[str, Curves], at: FloatArray, across: str
) -> "Figure":
    figure, panels = new_figure(1, 3, (13.0, 4.6))
    floor, _ = floor_m(found.runs)
    titles = {"mean": "mean", "median": "median", "p90": "90th percentile"}
    for panel, (what, title) in zip(panels, titles.items(), strict=True):
        for name, curve in curves.items():
            _line(panel, name, at, getattr(curve, what))
        draw_best_of_all(panel, floor)
        panel.set_title(f"{title};  best of all gaits {cm(floor)}", fontsize=9)
    finish_curves(figure, panels, 3, across, UP, f"All worlds and legs, over {across}")
    return figure


def kinds_figure(found: TransferFound) -> "Figure":
    """Means over trials, one panel per kind of world."""
    kinds = found.kinds
    rows, columns = grid_of(len(kinds))
    figure, panels = new_figure(rows, columns, (4.6 * columns + 0.6, 3.4 * rows + 0.8))
    trials = np.arange(1.0, found.plan.budget + 1)
    for panel, kind in zip(panels, kinds, strict=False):
        for name in found.plan.optimizers:
            _line(panel, name, trials, by_trials(found.of(name, kind)).mean)
        here = of(found.runs, kind=kind)
        draw_best_of_all(panel, floor_m(here)[0])
        panel.set_title(f"{kind}, {places(here)} worlds and legs", fontsize=9)
    finish_curves(figure, panels, len(kinds), "trials", UP, "Mean, by the kind of world")
    return figure


def _line(panel: "Axes", name: str, across: FloatArray, values: FloatArray) -> None:
    strong = name.startswith("bayes")
    panel.plot(across, values, linewidth=2.2 if strong else 1.1, label=name, **line_of(name))


#: Trials at which tables show the curves, as far as the budget goes.
SHOWN = (1, 2, 3, 4, 6, 8, 10, 15, 20, 40, 60)


def drawings(found: TransferFound) -> list[Drawing]:
    """Return the figures of the report."""
    here = "Red lines: 10 cm and 2.5 cm. The scale is logarithmic."
    draw = {"over_trials": trials_figure, "over_seconds": seconds_figure, "kinds": kinds_figure}
    return [
        Drawing(name=f"transfer_{name}", draw=lambda one=one: one(found), here=here)  # type: ignore[misc]
        for name, one in draw.items()
    ]


def transfer_json(found: TransferFound) -> dict[str, Any]:
    """Return settings and results of a benchmark as JSON values."""
    floor, error_m = floor_m(found.runs)
    return {
        "robot": found.plan.robot.name,
        **plain(found.plan, "worlds", "legs", "optimizers", "runs", "budget", "duration_s", "target_m"),
        "uncertainty": found.uncertainty.as_json(),
        "code": code_versions(),
        "landscapes": places(found.runs),
        "landscapes_without_valid_gait": found.without,
        "best_of_all_m": json_value(floor),
        "best_of_all_standard_error_m": json_value(error_m),
        "reachable": {f"{bound:g}": places(found.reachable(bound)) for bound in (EARLY_M, LATE_M)},
        "bars": [bar.as_json() for bar in transfer_bars(found)],
        "optimizers_found": {name: _found(found.of(name)) for name in found.plan.optimizers},
    }


def _found(runs: "DataFrame") -> dict[str, Any]:
    curves, error_m, (share, outcomes) = by_trials(runs), standard_error_m(runs), coverage(runs)
    shown = [count for count in SHOWN if count <= len(curves.mean)]
    return {
        **{
            f"{what}_m": {str(count): json_value(getattr(curves, what)[count - 1]) for count in shown}
            for what in ("mean", "median", "p90")
        },
        "standard_error_m": {str(count): json_value(error_m[count - 1]) for count in shown},
        "trials_to": {f"{bound:g}": curves.trials_to(bound) for bound in (EARLY_M, LATE_M)},
        "walked_s": json_value(walked_s(runs)),
        "coverage": json_value(share),
        "outcomes": outcomes,
    }


def sections(found: TransferFound, pictures: Mapping[str, Picture]) -> Iterator[Section]:
    """Return the parts of the report."""
    yield from _verdicts(found)
    for name, picture in pictures.items():
        yield Section(name.removeprefix("transfer_").replace("_", " ").capitalize(), [picture])
    yield Section("All worlds and legs", _curves(found, found.runs))
    yield Section("Where some gait is within 2.5 cm", _curves(found, found.reachable(LATE_M)))
    for kind in found.kinds:
        yield Section(f"Kind {kind}", _curves(found, of(found.runs, kind=kind)))
    yield Section("How sure bayes was", [_sure_table(found)])


def _verdicts(found: TransferFound) -> Iterator[Section]:
    plan = found.plan
    settings = (
        f"Robot {plan.robot.name}; legs {', '.join(str(leg) for leg in plan.legs)} locked, self-rotation "
        f"rear, {plan.duration_s:g} s a trial; {plan.worlds} worlds; {plan.budget} trials; {plan.runs} runs "
        f"of each search that has a seed; prior of {plan.prior.worlds} worlds a leg; "
        f"target {cm(plan.target_m)}."
    )
    yield Section("", [settings, found.uncertainty.sentence])
    rows = [(bar.asked, bar.measured, bar.verdict) for bar in transfer_bars(found)]
    yield Section("Bars", [Table(("asked", "measured", "verdict"), rows)])
    yield reading("transfer", _reach(found))


def _reach(found: TransferFound) -> str:
    within = [places(found.reachable(bound)) for bound in (EARLY_M, LATE_M)]
    return (
        f"Best of all gaits: {cm_with_error(*floor_m(found.runs))} on average. Of {places(found.runs)} "
        f"worlds and legs {within[0]} have a valid gait within 10 cm and {within[1]} one within 2.5 cm; "
        f"{found.without} more have no valid gait and are left out."
    )


def _curves(found: TransferFound, runs: "DataFrame") -> list[Block]:
    shown = [count for count in SHOWN if count <= found.plan.budget]
    rows: list[Sequence[str]] = []
    for name in found.plan.optimizers if len(runs) else ():
        some = of(runs, optimizer=name)
        curves, error_m = by_trials(some), standard_error_m(some)
        means = [cm_with_error(curves.mean[count - 1], error_m[count - 1]) for count in shown]
        rows.append([f"{name}, mean", *means])
        for what in ("median", "p90"):
            values = getattr(curves, what)
            rows.append([f"{name}, {what}", *[cm(float(values[count - 1])) for count in shown]])
    floor = cm_with_error(*floor_m(runs)) if len(runs) else "-"
    note = f"{places(runs)} worlds and legs; best of all gaits {floor}. Means ± standard error over worlds."
    return [note, Table(("deviation", *[f"after {count}" for count in shown]), rows)]


def _sure_table(found: TransferFound) -> Table:
    rows = []
    for name in (name for name in found.plan.optimizers if name in PRIORED):
        runs = found.of(name)
        (share, outcomes), (sure, trials) = coverage(runs), sure_share(runs)
        by_kind = ", ".join(f"{kind} {coverage(found.of(name, kind))[0]:.0%}" for kind in found.kinds)
        walked = f"{walked_s(runs):.0f} s"
        rows.append([name, f"{share:.1%} of {outcomes}", f"{sure:.0%}", f"{trials:.1f}", walked, by_kind])
    header = ("", "outcomes in their 90 % interval", "ended sure", "after trials", "walked", "by kind")
    return Table(header, rows)


def transfer_lines(found: TransferFound) -> list[str]:
    """Return the verdicts as lines of text."""
    return bar_lines(transfer_bars(found))


def transfer_tables(found: TransferFound) -> "dict[str, DataFrame]":
    """Return the table of all trials: a row for each trial of each run."""
    runs = found.runs
    counts = [len(codes) for codes in runs["codes"]]
    table = runs[["world", "kind", "leg", "optimizer", "run"]].loc[runs.index.repeat(counts)]
    ends = {
        name: np.concatenate([values[:count] for values, count in zip(runs[name], counts, strict=True)])
        for name in ("best_m", "walked_s")
    }
    trials = np.concatenate([np.arange(1, count + 1) for count in counts])
    return {"transfer": table.assign(trial=trials, code=np.concatenate(runs["codes"].to_list()), **ends)}
