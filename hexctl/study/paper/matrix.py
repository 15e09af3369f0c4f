"""Verdicts on every claim of the paper under every reading of what the paper leaves open."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any, ClassVar

from hexctl.backends.sim.world import World
from hexctl.errors import InputError, argument
from hexctl.robot.model import Robot
from hexctl.study.experiment import Experiment, plain, records, where
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.paper.claims import NAMES, claims_of
from hexctl.study.paper.evidence import Claim
from hexctl.study.paper.searches import search_all
from hexctl.study.paper.study_plan import StudyPlan
from hexctl.study.plan import LandscapePlan
from hexctl.study.report_page import Section, Table, markdown
from hexctl.study.versions import code_versions
from hexctl.study.walking import Work

if TYPE_CHECKING:
    from pandas import DataFrame

#: Default settings. The others are varied one at a time from the first of each.
FAILURES = ("locked", "limp", "weak:0.5", "missing")
WORLDS = ("flat", "slippery", "slope")
TIME_STEPS_S = (0.002, 0.004)
ROBOTS = ("ant", "phantomx", "pexod")

#: Worlds of each cell, and gaits walked without self-rotation; more would add nothing.
CELL_WORLDS, CELL_GAITS = 3, 40

#: Meaning of a verdict without an interval.
SINGLE_WORLD = (
    "A verdict in brackets is that of a single world: the number itself decides, and no interval tells by "
    "how much another world would change it."
)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One setting of the matrix; its title names robot, failure, world and time step."""

    title: str
    plan: StudyPlan

    def specs(self) -> list[LandscapeSpec]:
        """Return the specs of its landscapes, titled by the setting."""
        specs = self.plan.specs()
        return [replace(one, place=", ".join(filter(None, (self.title, one.place)))) for one in specs]

    def rows(self, claims: Sequence[Claim]) -> list[dict[str, Any]]:
        """Return the claims judged in this setting, a row for each; a verdict of one world is in brackets."""
        rows = []
        for name, claim in zip(NAMES, claims, strict=True):
            short = claim.verdict.partition(":")[0]
            single = claim.holds is not None and self.plan.worlds == 1
            named = {"setting": self.title, "name": name, "short": f"({short})" if single else short}
            rows.append({**named, **asdict(claim), "verdict": claim.verdict})
        return rows

    def as_json(self, claims: "DataFrame") -> dict[str, Any]:
        """Return the setting and its claims as plain JSON values."""
        return {
            "title": self.title,
            "robot": self.plan.robot.name,
            "world": self.plan.world.model_dump(mode="json"),
            **plain(self.plan, "failure", "self_rotation", "worlds", "runs"),
            "interval_tested": self.plan.worlds > 1,
            "claims": records(claims.drop(columns=["setting", "short"])),
        }


def cells_of(
    robots: Sequence[Robot], worlds: dict[str, World], failures: Sequence[str], steps_s: Sequence[float],
    /, **options: Any,
) -> tuple[Cell, ...]:  # fmt: skip
    """Cells of a matrix: each failure with the first robot, world and step, and with each other one of them.

    Args:
        failures: as `parse_failure` reads them.
        options: further fields of `StudyPlan`.

    Raises InputError for an empty list, and for a step that a world does not take.
    """
    for name, given in (("robot", robots), ("world", worlds), ("failure", failures), ("time_steps", steps_s)):
        if not given:
            raise InputError(f"{argument(name)}: got none; allowed: one or more with --matrix")
    first = (robots[0], next(iter(worlds)), steps_s[0])
    settings = [
        first,
        *((robots[0], name, steps_s[0]) for name in list(worlds)[1:]),
        *((robots[0], first[1], step_s) for step_s in steps_s[1:]),
        *((robot, first[1], steps_s[0]) for robot in robots[1:]),
    ]
    return tuple(
        _cell(robot, failure, name, worlds[name], step_s, options)
        for robot, name, step_s in settings
        for failure in failures
    )


def _cell(
    robot: Robot, failure: str, name: str, world: World, step_s: float, options: dict[str, Any]
) -> Cell:
    stepped = World.model_validate(world.model_dump() | {"time_step_s": step_s})
    defaults = {"worlds": CELL_WORLDS, "without_gaits": CELL_GAITS, "by_symmetry": True}
    plan = StudyPlan(robot=robot, world=stepped, failure=failure, **(defaults | options))
    return Cell(title=f"{robot.name}, {name}, {1000 * step_s:g} ms, {failure}", plan=plan)


@dataclass(frozen=True, kw_only=True)
class MatrixPlan(LandscapePlan, Experiment["DataFrame"]):
    """Settings of a matrix: its cells."""

    NAME: ClassVar[str] = "matrix"
    REPORT: ClassVar[str] = "matrix.html"
    HEADING: ClassVar[str] = "Verdicts on the paper's claims"
    cells: tuple[Cell, ...]

    def specs(self) -> list[LandscapeSpec]:
        """Return the specs of all landscapes, cell by cell."""
        return [spec for cell in self.cells for spec in cell.specs()]

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        for cell in self.cells:
            cell.plan.check()

    def find(self, work: Work) -> "DataFrame":
        """Simulate and search all cells; a row for each claim in each."""
        from pandas import DataFrame

        landscapes = iter(work.evaluate(self.specs()))
        work.progress.stage("searches, cell by cell", len(self.cells))
        rows = []
        for cell in self.cells:
            findings = search_all(cell.plan, [next(landscapes) for _ in cell.specs()])
            rows += cell.rows(claims_of(findings))
            work.progress.step()
        return DataFrame(rows)

    def numbers(self, findings: "DataFrame") -> dict[str, Any]:
        """Return the verdicts of the cells as plain JSON values."""
        holds = findings["holds"].eq(True).groupby(findings["name"], sort=False).all()
        return {
            "code": code_versions(),
            "cells": [cell.as_json(where(findings, setting=cell.title)) for cell in self.cells],
            "survive": holds.index[holds].to_list(),
        }

    def _table(self, findings: "DataFrame") -> Table:
        verdicts = findings.pivot(index="setting", columns="name", values="short")[list(NAMES)]
        rows = [[cell.title, str(cell.plan.worlds), *verdicts.loc[cell.title]] for cell in self.cells]
        return Table(("setting", "worlds", *NAMES), rows)

    def lines(self, findings: "DataFrame") -> list[str]:
        """Return the table of verdicts in Markdown."""
        return [
            line.replace("does not hold", "**does not hold**") for line in markdown(self._table(findings))
        ]

    def sections(self, findings: "DataFrame") -> Iterator[Section]:
        """Return the parts of the report."""
        gaits = " or ".join(map(str, sorted({cell.plan.without_gaits for cell in self.cells})))
        note = f"Without self-rotation {gaits} gaits. {SINGLE_WORLD}"
        yield Section("Verdicts", [note, self._table(findings)])
        names = ("claim", "rule", "measured", "null", "verdict")
        header = ("claim of the paper", "holds here if", "measured here", "random numbers", "verdict")
        columns = {title: itemgetter(name) for title, name in zip(header, names, strict=True)}
        for cell in self.cells:
            claims = where(findings, setting=cell.title).to_dict("records")
            yield Section(cell.title, [Table.of(claims, columns)])
