"""Experiments in held-out worlds: a row for each walk, and statistics of groups of them."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from hexctl.backends.sim.world import MAX_MEMBERS, DomainRandomization
from hexctl.control.trial_plan import DURATION_S
from hexctl.options import Range, Typed
from hexctl.robot.model import Robot
from hexctl.study.experiment import Experiment, json_value, plain
from hexctl.study.held_out import SENSORS, members, with_sensors
from hexctl.study.paper.evidence import clustered_error, mean
from hexctl.study.plan import check_legs, check_setting
from hexctl.study.report_page import Section, Table, reading
from hexctl.study.study_options import ALL_LEGS, WORLDS
from hexctl.study.versions import code_versions
from hexctl.study.walk_cache import Walked
from hexctl.study.walking import Work
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame

#: One row of a table of statistics.
Record = dict[str, Any]

#: Titles of the columns of such a table, and the text of each cell.
Columns = Mapping[str, Callable[[Record], str]]


def frame_of(walked: Walked, walks: Sequence[Sequence[Any]]) -> "DataFrame":
    """Return a row for each walk. Column `place` is the world, by which standard errors are clustered."""
    from pandas import DataFrame

    rows = [
        place.row(walk)  # type: ignore[attr-defined]
        for (place, _), some in zip(walked, walks, strict=True)
        for walk in some
    ]
    return DataFrame({**row, "place": f"{row['family']}:{row['world']}"} for row in rows)


def percentile(values: FloatArray, percent: float) -> float:
    """Percentile of values; NaN without any."""
    return float(np.percentile(values, percent)) if values.size else float("nan")


def mean_with_error(rows: "DataFrame", column: str) -> tuple[float, float]:
    """Return the mean of a column, NaN left out, and its standard error over worlds; NaN for one world."""
    known = np.isfinite(rows[column].to_numpy(float))
    values, worlds = rows[column].to_numpy(float)[known], rows["place"].to_numpy()[known]
    return mean(values), float(clustered_error(values, worlds))


def end_statistics(rows: "DataFrame", percent: int) -> Record:
    """Return statistics of the ends of walks, among them a percentile.

    Walks that fell, diverged or were stopped have no `final_m` (NaN); those without progress have.
    """
    ends = rows[rows["final_m"].notna()]
    final_m, (mean_m, mean_error_m) = ends["final_m"].to_numpy(float), mean_with_error(rows, "final_m")
    fell = int((rows["status"] == "fell").sum())
    return {
        "worlds": int(rows["place"].nunique()),
        "mean_m": mean_m,
        "mean_error_m": mean_error_m,
        f"p{percent}_m": percentile(final_m, percent),
        "max_m": percentile(final_m, 100),
        f"way_p{percent}_m": percentile(ends["way_m"].to_numpy(float), percent),
        "no_progress": int((rows["status"] == "no_progress").sum()),
        "fell": fell,
        "others": len(rows) - len(ends) - fell,
    }


def worlds_text(walks: int, worlds: int) -> str:
    """Text of a number of walks and of their worlds."""
    return f"{walks} in {worlds} world{'s' * (worlds != 1)}"


def groups(rows: "DataFrame", divisions: Mapping[str, str]) -> Iterator[tuple[str, str, "DataFrame"]]:
    """Return name of the division, name of the group and rows, by the values of some columns."""
    for division, column in divisions.items():
        for name, some in rows.groupby(column, sort=False):
            yield division, str(name), some


@dataclass(frozen=True, kw_only=True)
class HeldOutExperiment(Experiment["DataFrame"]):
    """Settings of an experiment whose walks are compared in held-out worlds.

    Attributes:
        failures: of each leg, as `parse_kind` reads them; intact robots walk too.
        exact_sensors: keep the sensors of the family instead of `SENSORS`.
    """

    #: Column by whose values walks are compared, and the columns of the tables, the first one the group.
    BY: ClassVar[str]
    COLUMNS: ClassVar[Columns]

    robots: Annotated[tuple[Robot, ...], Typed(flag="robot")]
    families: Annotated[dict[str, DomainRandomization], Typed(flag="world")]
    worlds: Annotated[int, WORLDS] = 10
    first_world: Annotated[int, Range(low=0, high=MAX_MEMBERS, whole=True)] = 0
    legs: tuple[int, ...] = ALL_LEGS
    failures: Annotated[tuple[str, ...], Typed(flag="failure")] = ("locked",)
    duration_s: Annotated[float, DURATION_S] = 30.0
    exact_sensors: bool = False

    def members(self) -> Iterator[dict[str, Any]]:
        """Return the fields of the place of each robot in each world."""
        for one in members(self.robots, self.families, self.first_world, self.worlds):
            world = one["world"] if self.exact_sensors else with_sensors(one["world"])
            yield one | {"world": world, "duration_s": self.duration_s}

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        check_legs(self.legs)
        most = min(int(WORLDS.high), MAX_MEMBERS - self.first_world)
        check_setting("worlds", self.worlds, self.worlds <= most, f"1..{most}")

    def find(self, work: Work) -> "DataFrame":
        """Simulate all walks; a row for each."""
        walked = self.walked()
        return self.columns(frame_of(walked, work.walk(walked)))

    @staticmethod
    @abstractmethod
    def columns(rows: "DataFrame") -> "DataFrame":
        """Return the walks with derived columns."""

    @staticmethod
    @abstractmethod
    def divisions(rows: "DataFrame") -> "Iterator[tuple[str, str, DataFrame]]":
        """Return name of a division, name of a group in it, and its walks."""

    @staticmethod
    @abstractmethod
    def summary(rows: "DataFrame") -> Record:
        """Return the statistics of some walks."""

    def statistics(self, rows: "DataFrame") -> list[Record]:
        """Return the statistics of each group of walks, for each compared value."""
        return [
            {"division": division, "group": name, self.BY: value} | self.summary(some[some[self.BY] == value])
            for division, name, some in self.divisions(rows)
            for value in getattr(self, f"{self.BY}s")
        ]

    def numbers(self, findings: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        return {
            "robots": [robot.name for robot in self.robots],
            "families": list(self.families),
            **plain(self, "first_world", "worlds", "legs", "failures", "duration_s"),
            "sensors": None if self.exact_sensors else SENSORS,
            "code": code_versions(),
            "walks": len(findings),
            "statistics": [
                {name: json_value(value) for name, value in one.items()} for one in self.statistics(findings)
            ],
        }

    def settings_text(self, walks: int) -> str:
        """Robots, worlds, legs, number of walks and sensors in words."""
        sensors = (
            "Sensors as the worlds have them."
            if self.exact_sensors
            else "Sensors 40 ms late, with 1 cm and 0.5 degrees of noise; 5 % of the poses are lost."
        )
        return (
            f"{', '.join(robot.name for robot in self.robots)}; worlds {self.first_world} to "
            f"{self.first_world + self.worlds - 1} of {' and '.join(self.families)}; legs "
            f"{', '.join(map(str, self.legs))}, each {', '.join(self.failures)}, and intact robots; "
            f"{walks} walks of {self.duration_s:g} s. {sensors}"
        )

    def remarks(self, findings: "DataFrame") -> list[str]:
        """Return further texts at the head of the report."""
        return []

    def sections(self, findings: "DataFrame") -> Iterator[Section]:
        """Return the parts of the report: settings, and a table for each division."""
        yield Section("", [self.settings_text(len(findings)), *self.remarks(findings)])
        yield reading(self.NAME)
        records = self.statistics(findings)
        for division in dict.fromkeys(one["division"] for one in records):
            some = [one for one in records if one["division"] == division]
            title = "All" if division == "all" else f"By {division}"
            yield Section(title, [Table.of(some, self.COLUMNS)])
