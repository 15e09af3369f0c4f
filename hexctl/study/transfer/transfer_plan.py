"""The transfer benchmark: adaptation in worlds outside every prior."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hexctl.adapt.optimizers.shipped import BAYES
from hexctl.study.data_frames import json_value, where
from hexctl.study.experiment import Drawing, Experiment, plain
from hexctl.study.figure_style import draw_curves, finish_curves, grid_of, new_figure
from hexctl.study.paper.evidence import (
    EARLY_M,
    LATE_M,
    Bar,
    StudyUncertainty,
    bar_lines,
    bar_table,
    cm,
    cm_with_error,
    judged_bars,
)
from hexctl.study.paper.searches import curve_of
from hexctl.study.paper.study_settings import BASELINE
from hexctl.study.report_page import Block, Picture, Section, Table, reading
from hexctl.study.transfer.transfer_searches import (
    by_seconds,
    coverage,
    floor_m,
    search_worlds,
    standard_error_m,
    sure_share,
    trials_to,
    walked_s,
)
from hexctl.study.transfer.transfer_settings import PRIORED, TransferSettings
from hexctl.study.versions import code_versions
from hexctl.study.walking import Work

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

#: Mean deviation over all worlds and legs, the maximum number of trials to reach it, and the stretch goal.
ASKED = ((EARLY_M, 4, 2), (LATE_M, 12, 6))

#: Maximum of trials that `bayes` may need beyond random search, in any kind of world.
MORE_THAN_RANDOM = 2

#: Required share of outcomes inside their 90 % intervals.
COVERAGE = (0.85, 0.95)

#: Points of the curves over seconds.
SECONDS = 120

#: Trials at which tables show the curves, up to the budget.
SHOWN = (1, 2, 3, 4, 6, 8, 10, 15, 20, 40, 60)

#: Statistics of curves and their titles.
STATISTICS = {"mean_m": "mean", "median_m": "median", "p90_m": "90th percentile"}


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferFound:
    """The results of one benchmark.

    Attributes:
        runs: a row for each run of a search, see `search_worlds`.
        without: number of landscapes without a valid gait, which are left out.
    """

    runs: "DataFrame"
    without: int = 0
    uncertainty: StudyUncertainty = field(default_factory=StudyUncertainty)

    def of(self, optimizer: str, **values: object) -> "DataFrame":
        """Return the runs of an optimizer in which columns have given values."""
        return where(self.runs, optimizer=optimizer, **values)

    def reachable(self, bound_m: float) -> "DataFrame":
        """Return the runs in landscapes whose best gait is within a bound."""
        return self.runs[self.runs["best_of_all_m"] <= bound_m]

    @property
    def kinds(self) -> list[str]:
        """Kinds of worlds, in the order of their first appearance."""
        return list(self.runs["kind"].unique())


def places(runs: "DataFrame") -> int:
    """Return the number of landscapes."""
    return int(runs["place"].nunique())


@dataclass(frozen=True, kw_only=True)
class TransferPlan(TransferSettings, Experiment[TransferFound]):
    """The transfer benchmark with its settings."""

    NAME: ClassVar[str] = "transfer"
    REPORT: ClassVar[str] = "transfer.html"
    TITLE: ClassVar[str] = "hexctl study --transfer"
    HEADING: ClassVar[str] = "Adaptation in worlds outside every prior"

    def find(self, work: Work) -> TransferFound:
        """Walk all gaits and run every optimizer in every landscape."""
        specs = self.specs()
        uncertainty = StudyUncertainty.of(
            self.robot, specs[0].world, self.duration_s, work.cache.folder.parent, failure=self.failure
        )
        landscapes = work.evaluate(specs)
        work.lap("landscapes")
        work.progress.stage("searches, world by world", len(landscapes))
        runs = search_worlds(self, landscapes, work.progress.step)
        work.lap("searches")
        without = sum(not landscape.valid.any() for landscape in landscapes)
        return TransferFound(runs=runs, without=without, uncertainty=uncertainty)

    def bars(self, found: TransferFound) -> list[Bar]:
        """Return the bars that optimizers and budget reach; too short walks are not judged."""
        if BAYES not in self.optimizers:
            return []
        share, outcomes = coverage(found.of(BAYES))
        low, high = COVERAGE
        inside = Bar(
            name="coverage",
            asked=f"{low:.0%} to {high:.0%} of outcomes in their 90 % intervals",
            measured=f"{share:.1%} of {outcomes}",
            holds=low <= share <= high,
        )
        return judged_bars([*self._means(found), *self._against_random(found), inside], self.duration_s)

    def _means(self, found: TransferFound) -> Iterator[Bar]:
        curve = curve_of(found.of(BAYES))
        for bound_m, within, stretch in ASKED:
            if within > self.budget:
                continue
            needed = trials_to(curve, bound_m)
            yield Bar(
                name=f"mean_{bound_m:g}_m",
                asked=f"mean within {cm(bound_m)} after {within} trials (stretch: {stretch})",
                measured=f"{_trials(needed)}; {cm(float(curve['mean_m'][within]))} after {within}",
                holds=needed is not None and needed <= within,
            )

    def _against_random(self, found: TransferFound) -> Iterator[Bar]:
        """Compare with random search by kind of world, if one of both reaches the bound within the budget."""
        for kind in found.kinds if BASELINE in self.optimizers else ():
            bayes, random = (curve_of(found.of(name, kind=kind)) for name in (BAYES, BASELINE))
            for bound_m in (EARLY_M, LATE_M):
                ours, theirs = trials_to(bayes, bound_m), trials_to(random, bound_m)
                if theirs is None and ours is None:
                    continue
                limit = f"{MORE_THAN_RANDOM} trials after random at most"
                yield Bar(
                    name=f"{kind}_{bound_m:g}_m",
                    asked=f"{kind}: mean within {cm(bound_m)}, {limit}",
                    measured=f"{_trials(ours)}, random {_trials(theirs)}",
                    holds=ours is not None and (theirs is None or ours <= theirs + MORE_THAN_RANDOM),
                )

    def numbers(self, found: TransferFound) -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        floor, error_m = floor_m(found.runs)
        names = ("worlds", "legs", "optimizers", "runs", "budget", "duration_s", "target_m")
        return {
            "robot": self.robot.name,
            **plain(self, *names),
            "uncertainty": found.uncertainty.as_json(),
            "code": code_versions(),
            "landscapes": places(found.runs),
            "landscapes_without_valid_gait": found.without,
            "best_of_all_m": json_value(floor),
            "best_of_all_standard_error_m": json_value(error_m),
            "reachable": {f"{bound:g}": places(found.reachable(bound)) for bound in (EARLY_M, LATE_M)},
            "bars": [bar.as_json() for bar in self.bars(found)],
            "optimizers_found": {name: self._found(found.of(name)) for name in self.optimizers},
        }

    def _found(self, runs: "DataFrame") -> dict[str, Any]:
        curve, (share, outcomes) = curve_of(runs), coverage(runs)
        curve["standard_error_m"] = standard_error_m(runs)
        return {
            **{
                name: {str(count): json_value(curve[name][count]) for count in self._shown}
                for name in (*STATISTICS, "standard_error_m")
            },
            "trials_to": {f"{bound:g}": trials_to(curve, bound) for bound in (EARLY_M, LATE_M)},
            "walked_s": json_value(walked_s(runs)),
            "coverage": json_value(share),
            "outcomes": outcomes,
        }

    @property
    def _shown(self) -> list[int]:
        return [count for count in SHOWN if count <= self.budget]

    def lines(self, found: TransferFound) -> list[str]:
        """Return the verdicts as lines of text."""
        return bar_lines(self.bars(found))

    def tables(self, found: TransferFound) -> "Mapping[str, DataFrame]":
        """Return the table of all trials: a row for each trial of each run."""
        head, trials = ["world", "kind", "leg", "optimizer", "run"], ["best_m", "walked_s"]
        runs = found.runs[[*head, "codes", *trials]].rename(columns={"codes": "code"})
        for name in trials:
            pairs = zip(runs[name], runs["code"], strict=True)
            runs[name] = [values[: len(codes)] for values, codes in pairs]
        runs["trial"] = [range(1, len(codes) + 1) for codes in runs["code"]]
        table = runs[[*head, "trial", "code", *trials]].explode(["trial", "code", *trials])
        return {"transfer": table.astype({"trial": int, "code": int, "best_m": float, "walked_s": float})}

    def drawings(self, found: TransferFound) -> list[Drawing]:
        """Return the figures of the report."""
        here = "Red lines: 10 cm and 2.5 cm. The scale is logarithmic."
        seconds = np.linspace(0, self.budget * self.duration_s, SECONDS + 1)[1:]
        over: dict[str, tuple[str, Callable[[DataFrame], DataFrame]]] = {
            "trials": ("trials", curve_of),
            "seconds": ("seconds walked", partial(by_seconds, seconds=seconds)),
        }
        draw = {
            f"over_{name}": partial(self._curves_figure, found, across, curve)
            for name, (across, curve) in over.items()
        }
        draw["kinds"] = partial(self._kinds_figure, found)
        return [Drawing(name=f"transfer_{name}", draw=one, here=here) for name, one in draw.items()]

    def _curves_figure(
        self, found: TransferFound, across: str, curve: "Callable[[DataFrame], DataFrame]"
    ) -> "Figure":
        curves = {name: curve(found.of(name)) for name in self.optimizers}
        floor, _ = floor_m(found.runs)
        panels = {
            f"{title};  best of all gaits {cm(floor)}": {name: one[what] for name, one in curves.items()}
            for what, title in STATISTICS.items()
        }
        return _lines_figure(panels, [floor] * 3, (13.0, 4.6), across, f"All worlds and legs, over {across}")

    def _kinds_figure(self, found: TransferFound) -> "Figure":
        some = {kind: where(found.runs, kind=kind) for kind in found.kinds}
        panels = {
            f"{kind}, {places(runs)} worlds and legs": {
                name: curve_of(where(runs, optimizer=name))["mean_m"] for name in self.optimizers
            }
            for kind, runs in some.items()
        }
        rows, columns = grid_of(len(some))
        size_in = (4.6 * columns + 0.6, 3.4 * rows + 0.8)
        floors = [floor_m(runs)[0] for runs in some.values()]
        return _lines_figure(panels, floors, size_in, "trials", "Mean, by the kind of world")

    def sections(self, found: TransferFound, pictures: Mapping[str, Picture]) -> Iterator[Section]:
        """Return the parts of the report."""
        settings = (
            f"Robot {self.robot.name}; legs {', '.join(str(leg) for leg in self.legs)} locked, self-rotation "
            f"rear, {self.duration_s:g} s a trial; {self.worlds} worlds; {self.budget} trials; {self.runs} "
            f"runs of each search that has a seed; prior of {self.prior.worlds} worlds a leg; "
            f"target {cm(self.target_m)}."
        )
        yield Section("", [settings, found.uncertainty.sentence])
        yield Section("Bars", [bar_table(self.bars(found))])
        yield reading("transfer", _reach(found))
        for name, picture in pictures.items():
            yield Section(name.removeprefix("transfer_").replace("_", " ").capitalize(), [picture])
        yield Section("All worlds and legs", self._curves(found.runs))
        yield Section("Where some gait is within 2.5 cm", self._curves(found.reachable(LATE_M)))
        for kind in found.kinds:
            yield Section(f"Kind {kind}", self._curves(where(found.runs, kind=kind)))
        yield Section("How sure bayes was", [self._sure_table(found)])

    def _curves(self, runs: "DataFrame") -> list[Block]:
        rows: list[list[str]] = []
        for name in self.optimizers if len(runs) else ():
            some = where(runs, optimizer=name)
            curve, error_m = curve_of(some), standard_error_m(some)
            means = [cm_with_error(curve["mean_m"][count], error_m[count - 1]) for count in self._shown]
            rows.append([f"{name}, mean", *means])
            rows += [
                [f"{name}, {what}", *[cm(curve[f"{what}_m"][count]) for count in self._shown]]
                for what in ("median", "p90")
            ]
        floor = cm_with_error(*floor_m(runs)) if len(runs) else "-"
        note = (
            f"{places(runs)} worlds and legs; best of all gaits {floor}. Means ± standard error over worlds."
        )
        return [note, Table(("deviation", *[f"after {count}" for count in self._shown]), rows)]

    def _sure_table(self, found: TransferFound) -> Table:
        rows = []
        for name in (name for name in self.optimizers if name in PRIORED):
            runs = found.of(name)
            (share, outcomes), (sure, trials) = coverage(runs), sure_share(runs)
            by_kind = [f"{kind} {coverage(found.of(name, kind=kind))[0]:.0%}" for kind in found.kinds]
            walked = f"{walked_s(runs):.0f} s"
            row = [name, f"{share:.1%} of {outcomes}", f"{sure:.0%}", f"{trials:.1f}", walked]
            rows.append([*row, ", ".join(by_kind)])
        header = ("", "outcomes in their 90 % interval", "ended sure", "after trials", "walked", "by kind")
        return Table(header, rows)


def _trials(count: int | None) -> str:
    return "not within the budget" if count is None else f"after {count}"


def _reach(found: TransferFound) -> str:
    within = [places(found.reachable(bound)) for bound in (EARLY_M, LATE_M)]
    return (
        f"Best of all gaits: {cm_with_error(*floor_m(found.runs))} on average. Of {places(found.runs)} "
        f"worlds and legs {within[0]} have a valid gait within 10 cm and {within[1]} one within 2.5 cm; "
        f"{found.without} more have no valid gait and are left out."
    )


def _lines_figure(
    panels: "Mapping[str, Mapping[str, Any]]",
    floors: Sequence[float],
    size_in: tuple[float, float],
    across: str,
    title: str,
) -> "Figure":
    """Draw lines of optimizers in panels, by title, above the deviation of the best of all gaits."""
    figure, axes = new_figure(*grid_of(len(panels)), size_in)
    for axis, (name, lines), floor in zip(axes, panels.items(), floors, strict=False):
        draw_curves(axis, lines, floor, 1.1)
        axis.set_title(name, fontsize=9)
    finish_curves(figure, axes, len(panels), across, "deviation of the best gait so far", title)
    return figure
