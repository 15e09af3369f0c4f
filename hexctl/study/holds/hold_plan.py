"""Holds compared: where walks in held-out worlds end open loop, with the yaw, and with the pose."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from hexctl.control.trial_plan import AUTO_ROTATION, AskedRotation
from hexctl.options import Typed
from hexctl.robot.failure_grammar import parse_kind
from hexctl.study.experiment import Drawing, plain
from hexctl.study.held_out import INTACT
from hexctl.study.held_out_experiment import (
    HeldOutExperiment,
    Record,
    division_sections,
    table_of,
)
from hexctl.study.holds import hold_report as report
from hexctl.study.holds.hold_walks import Hold, HoldCase, HoldPlace
from hexctl.study.plan import check_walkable
from hexctl.study.reports.report_page import Bullets, Picture, Section, markdown
from hexctl.study.verdicts.claim_evidence import Bar
from hexctl.study.walk_cache import Walked

if TYPE_CHECKING:
    from pandas import DataFrame

#: Earlier members of the families were used while this comparison was built.
FIRST_WORLD = 250

#: Default family of worlds.
FAMILY = "transfer"


@dataclass(frozen=True, kw_only=True)
class HoldPlan(HeldOutExperiment):
    """Settings of a comparison of holds.

    Attributes:
        holds: feedback of the walks.
        self_rotation: direction of the failed leg during the walk. With `auto`, it points to the rear under
            the hold `heading` and stays as it is under the others, as `hexctl run --gait auto` does. Walks
            in open loop then have the gait of those that hold the line.
    """

    NAME: ClassVar[str] = "holds"
    REPORT: ClassVar[str] = "holds.html"
    TITLE: ClassVar[str] = "hexctl study --hold"
    HEADING: ClassVar[str] = "Open loop, with the yaw, with the pose"

    first_world: int = FIRST_WORLD
    failures: Annotated[tuple[str, ...], Typed(flag="failure")] = (
        "locked",
        "limp",
        "missing",
        "weak:0.5",
        "stuck:coxa",
    )
    holds: tuple[Hold, ...] = ("none", "heading", "line")
    self_rotation: AskedRotation = AUTO_ROTATION

    def places(self) -> list[HoldPlace]:
        """Return each robot in each world."""
        return [HoldPlace(self_rotation=self.self_rotation, **one) for one in self.members()]

    def cases(self) -> list[HoldCase]:
        """Return the cases in each place: intact, then leg by leg."""
        broken = [(0, INTACT), *((leg, failure) for leg in self.legs for failure in self.failures)]
        return [
            HoldCase(leg=leg, failure=failure, hold=hold) for leg, failure in broken for hold in self.holds
        ]

    def walked(self) -> Walked:
        """Return the cases to walk, place by place."""
        cases = self.cases()
        return [(place, cases) for place in self.places()]

    def check(self) -> None:
        """Raise InputError for settings that are not allowed, before anything runs."""
        super().check()
        for failure in self.failures:
            parse_kind(self.legs[0], failure)
        for place in self.places()[:: len(self.families) * self.worlds]:
            for case in self.cases():
                check_walkable(f"leg {case.leg} {case.failure}", place.trial(case))

    def columns(self, rows: "DataFrame") -> "DataFrame":
        """Return the walks with what is derived from them."""
        return report.with_ends(rows)

    def statistics(self, rows: "DataFrame") -> list[Record]:
        """Return the statistics of each group of walks and hold."""
        return [
            {"division": division, "group": name, "hold": hold}
            | report.statistics(some[some["hold"] == hold])
            for division, name, some in report.divisions(rows)
            for hold in self.holds
        ]

    def bars(self, rows: "DataFrame") -> list[Bar]:
        """Return the bars that the walks are to reach."""
        return report.hold_bars(rows, self.duration_s)

    def numbers(self, found: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        return super().numbers(found) | plain(self, "holds", "self_rotation")

    def lines(self, found: "DataFrame") -> list[str]:
        """Return the table of all walks of a failed leg, and the verdicts."""
        failed = [one for one in self.statistics(found) if one["division"] == "all"]
        return [*markdown(table_of(failed, report.COLUMNS)), *super().lines(found)]

    def tables(self, found: "DataFrame") -> "Mapping[str, DataFrame]":
        """Return the table of all walks."""
        return {"holds": found.rename(columns={"kind_of_world": "kind"}).drop(columns=["speed", "open_m"])}

    def drawings(self, found: "DataFrame") -> Sequence[Drawing]:
        """Return the figures of the report."""
        here = (
            "Heights are numbers of walks. Lines are means, dots 90th percentiles. The scale is logarithmic."
        )
        return (
            Drawing(name="holds", draw=lambda: report.holds_figure(self, found), here=here),
            Drawing(name="holds_by_failure", draw=lambda: report.failures_figure(self, found), here=here),
        )

    def sections(self, found: "DataFrame", pictures: Mapping[str, Picture]) -> Iterator[Section]:
        """Return the parts of the report."""
        rotation = f" Self-rotation: {self.self_rotation}."
        yield Section("", [self.settings_text(len(found)) + rotation])
        yield self.bars_section(found)
        yield Section("How to read this", [Bullets(report.READING)])
        yield Section("Where walks end", list(pictures.values()))
        yield from division_sections(self.statistics(found), report.COLUMNS)
