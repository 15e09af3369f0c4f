"""Holds compared: ends of walks in held-out worlds in open loop, with the yaw, and with the pose."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from hexctl.control.trial_plan import AUTO_ROTATION, AskedRotation
from hexctl.options import Typed
from hexctl.robot.failure_grammar import parse_kind
from hexctl.study.experiment import plain
from hexctl.study.held_out import INTACT
from hexctl.study.held_out_experiment import (
    Columns,
    HeldOutExperiment,
    Record,
    end_statistics,
    groups,
    mean_with_error,
    worlds_text,
)
from hexctl.study.hold_walks import Hold, HoldCase, HoldPlace
from hexctl.study.paper.evidence import cm, cm_with_error, share_text, share_with_error
from hexctl.study.plan import check_walkable
from hexctl.study.report_page import Table, markdown
from hexctl.study.walk_cache import ENDED

if TYPE_CHECKING:
    from pandas import DataFrame

#: Earlier worlds of the families were used to develop this comparison.
FIRST_WORLD = 250

#: Default family of worlds.
FAMILY = "transfer"

#: Holds in the words of the report.
HOLD_NAMES = {"none": "open loop", "heading": "yaw alone", "line": "pose"}


def statistics(rows: "DataFrame") -> Record:
    """Return the statistics of some walks with one hold; standard errors over worlds, NaN for one world."""
    over_ideal, over_ideal_error = mean_with_error(rows, "speed")
    return {
        "walks": len(rows),
        **end_statistics(rows, 90),
        "over_ideal": over_ideal,
        "over_ideal_error": over_ideal_error,
    }


def _count(name: str) -> Any:
    return lambda one: f"{one[name]} ({share_text(one[name] / one['walks'])})" if one[name] else "0"


COLUMNS: Columns = {
    "": itemgetter("group"),
    "holds": lambda one: HOLD_NAMES[one["hold"]],
    "walks": lambda one: worlds_text(one["walks"], one["worlds"]),
    "final: mean": lambda one: cm_with_error(one["mean_m"], one["mean_error_m"]),
    "90th percentile": lambda one: cm(one["p90_m"]),
    "maximum": lambda one: cm(one["max_m"]),
    "during the walk: 90th percentile": lambda one: cm(one["way_p90_m"]),
    "no progress": _count("no_progress"),
    "fell": _count("fell"),
    "stopped": _count("others"),
    "progress over ideal": lambda one: share_with_error(one["over_ideal"], one["over_ideal_error"]),
}


@dataclass(frozen=True, kw_only=True)
class HoldPlan(HeldOutExperiment):
    """Settings of a comparison of holds.

    Attributes:
        self_rotation: direction of the failed leg during the walk. With `auto`, it points to the rear under
            `heading`, and the robot does not turn under the others, as in `hexctl run --gait auto`. Walks in
            open loop then have the gait of those that hold the line.
    """

    NAME: ClassVar[str] = "holds"
    REPORT: ClassVar[str] = "holds.html"
    HEADING: ClassVar[str] = "Open loop, with the yaw, with the pose"

    BY: ClassVar[str] = "hold"
    COLUMNS: ClassVar[Columns] = COLUMNS
    summary = staticmethod(statistics)

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

    def cases(self) -> list[HoldCase]:
        """Return the cases in each place: intact, then leg by leg."""
        broken = [(0, INTACT), *((leg, failure) for leg in self.legs for failure in self.failures)]
        return [
            HoldCase(leg=leg, failure=failure, hold=hold) for leg, failure in broken for hold in self.holds
        ]

    def walked(self) -> list[tuple[HoldPlace, list[HoldCase]]]:
        """Return the cases to walk, place by place."""
        cases = self.cases()
        return [(HoldPlace(self_rotation=self.self_rotation, **one), cases) for one in self.members()]

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        for failure in self.failures:
            parse_kind(self.legs[0], failure)
        for place, cases in self.walked()[:: len(self.families) * self.worlds]:
            for case in cases:
                check_walkable(f"leg {case.leg} {case.failure}", place.trial(case))

    @staticmethod
    def columns(rows: "DataFrame") -> "DataFrame":
        """Return walks with final deviation and speed, NaN if they did not end on their feet."""
        ended = rows["status"].isin(ENDED)
        return rows.assign(
            final_m=rows["signed_m"].abs().where(ended),
            way_m=rows["max_m"],
            speed=(rows["distance_m"] / rows["ideal_distance_m"]).where(ended),
        )

    @staticmethod
    def divisions(rows: "DataFrame") -> Iterator[tuple[str, str, "DataFrame"]]:
        """Return divisions; all but that by failure leave intact robots out."""
        failed = rows[rows["failure"] != INTACT]
        yield "all", "one leg failed", failed
        yield from groups(rows, {"failure": "failure"})
        floor = failed.assign(floor=np.where(failed["rough"], "rough", "even"))
        columns = {"robot": "robot", "family": "family", "leg": "leg", "kind of world": "kind_of_world"}
        yield from groups(floor, columns | {"floor": "floor"})

    def numbers(self, findings: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        return super().numbers(findings) | plain(self, "holds", "self_rotation")

    def lines(self, findings: "DataFrame") -> list[str]:
        """Return the table of all walks of a failed leg."""
        failed = [one for one in self.statistics(findings) if one["division"] == "all"]
        return markdown(Table.of(failed, COLUMNS))

    def tables(self, findings: "DataFrame") -> "Mapping[str, DataFrame]":
        """Return the table of all walks."""
        shown = findings.drop(columns=["speed", "way_m", "place"])
        return {"holds": shown.rename(columns={"kind_of_world": "kind"})}

    def remarks(self, findings: "DataFrame") -> list[str]:
        """Return the self-rotation in words."""
        return [f"Self-rotation: {self.self_rotation}."]
