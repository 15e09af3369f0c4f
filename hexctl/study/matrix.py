"""The matrix of verdicts: every claim of the paper under every reading of what the paper leaves open."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, ClassVar

from hexctl.backends.sim.world import World
from hexctl.errors import InputError, argument
from hexctl.robot.model import Robot
from hexctl.study.claims import NAMES, claims_of
from hexctl.study.evidence import Claim
from hexctl.study.experiment import Drawing, Experiment, Work
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.report_page import Picture, Section, Table, markdown
from hexctl.study.searches import search_all
from hexctl.study.study_figures import verdicts_figure
from hexctl.study.study_settings import StudySettings
from hexctl.study.versions import code_versions
from hexctl.study.walk_cache import Walked

#: Claims of each cell, in the order of the cells.
Verdicts = tuple[tuple[Claim, ...], ...]

#: What is varied unless told otherwise; the first of each is the reading that the others differ from.
FAILURES = ("locked", "limp", "weak:0.5", "missing")
WORLDS = ("flat", "slippery", "slope")
TIME_STEPS_S = (0.002, 0.004)
ROBOTS = ("ant", "phantomx", "pexod")

#: Worlds of each cell, and gaits that are walked without self-rotation: what they show needs no more.
CELL_WORLDS, CELL_GAITS = 3, 40

#: How a verdict without an interval is to be read.
SINGLE_WORLD = (
    "A verdict in brackets is that of a single world: the number itself decides, and no interval tells by "
    "how much another world would change it."
)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One setting of the matrix.

    Attributes:
        title: robot, failure, world and time step as text.
        plan: the study of it.
    """

    title: str
    plan: StudySettings

    def specs(self) -> list[LandscapeSpec]:
        """Return the specs of its landscapes, titled by the setting."""
        specs = self.plan.specs()
        return [replace(one, place=", ".join(filter(None, (self.title, one.place)))) for one in specs]

    def short_verdict(self, claim: Claim) -> str:
        """Verdict without its reason; in brackets where it is that of a single world."""
        verdict = claim.verdict.partition(":")[0]
        return verdict if claim.holds is None or self.plan.worlds > 1 else f"({verdict})"


def cells_of(
    robots: Sequence[Robot], worlds: dict[str, World], failures: Sequence[str], steps_s: Sequence[float],
    /, **options: Any,
) -> tuple[Cell, ...]:  # fmt: skip
    """Cells of a matrix: each failure with the first robot, world and step, and with each other one of them.

    Args:
        robots: models of the robots.
        worlds: the worlds by name.
        failures: in the words of `parse_failure`.
        steps_s: steps of the physics.
        options: further fields of `StudySettings`.

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
    plan = StudySettings(robot=robot, world=stepped, failure=failure, **(defaults | options))
    return Cell(title=f"{robot.name}, {name}, {1000 * step_s:g} ms, {failure}", plan=plan)


@dataclass(frozen=True, kw_only=True)
class MatrixPlan(Experiment[Verdicts]):
    """Settings of a matrix: its cells."""

    NAME: ClassVar[str] = "matrix"
    REPORT: ClassVar[str] = "matrix.html"
    TITLE: ClassVar[str] = "hexctl study --matrix"
    HEADING: ClassVar[str] = "Verdicts on the paper's claims"
    UNIT: ClassVar[str] = "gaits"

    cells: tuple[Cell, ...]

    def specs(self) -> list[LandscapeSpec]:
        """Return the specs of all landscapes, cell by cell."""
        return [spec for cell in self.cells for spec in cell.specs()]

    def walked(self) -> Walked:
        """Return the gaits to walk, landscape by landscape."""
        return [(spec, spec.codes) for spec in self.specs()]

    def check(self) -> None:
        """Raise InputError for settings that are not allowed, before anything runs."""
        for cell in self.cells:
            cell.plan.check()

    def find(self, work: Work) -> Verdicts:
        """Walk and search all cells; the claims of each."""
        landscapes = iter(work.evaluate(self.specs()))
        work.lap("landscapes")
        work.progress.stage("searches, cell by cell", len(self.cells))
        verdicts = []
        for cell in self.cells:
            findings = search_all(cell.plan, [next(landscapes) for _ in cell.specs()])
            verdicts.append(tuple(claims_of(findings)))
            work.progress.step()
        work.lap("searches")
        return tuple(verdicts)

    def numbers(self, found: Verdicts) -> dict[str, Any]:
        """Return the verdicts of the cells as plain JSON values."""
        everywhere = [all(claims[row].holds is True for claims in found) for row in range(len(NAMES))]
        return {
            "code": code_versions(),
            "cells": [_cell_json(cell, some) for cell, some in zip(self.cells, found, strict=True)],
            "survive": [name for name, holds in zip(NAMES, everywhere, strict=True) if holds],
        }

    def _table(self, found: Verdicts) -> Table:
        """Setting, number of worlds and short verdicts of each cell."""
        rows = [
            [cell.title, str(cell.plan.worlds), *map(cell.short_verdict, claims)]
            for cell, claims in zip(self.cells, found, strict=True)
        ]
        return Table(("setting", "worlds", *NAMES), rows)

    def lines(self, found: Verdicts) -> list[str]:
        """Return the table of verdicts in Markdown."""
        return [line.replace("does not hold", "**does not hold**") for line in markdown(self._table(found))]

    def texts(self, found: Verdicts) -> Mapping[str, str]:
        """Return the table of verdicts as a file in Markdown."""
        return {"matrix.md": "\n".join(self.lines(found)) + "\n"}

    def drawings(self, found: Verdicts) -> Sequence[Drawing]:
        """Return the figure of the report."""
        counts = sorted({cell.plan.without_gaits for cell in self.cells})
        here = (
            "Each failed leg of each robot with all gaits. Legs that are one experiment are walked once, and "
            f"without self-rotation {' or '.join(map(str, counts))} gaits. {SINGLE_WORLD} The study's page "
            "says how claims are judged."
        )
        rows = [(title, verdicts) for title, _, *verdicts in self._table(found).rows]
        draw = partial(verdicts_figure, rows, NAMES)
        return (Drawing(name="matrix", draw=draw, here=here, paper="One robot, one simulator, one reading."),)

    def sections(self, found: Verdicts, pictures: Mapping[str, Picture]) -> Iterator[Section]:
        """Return the parts of the report."""
        yield Section("Verdicts", [*pictures.values(), self._table(found)])
        header = ("claim of the paper", "holds here if", "measured here", "random numbers", "verdict")
        for cell, claims in zip(self.cells, found, strict=True):
            lines = [(one.claim, one.rule, one.measured, one.null, one.verdict) for one in claims]
            yield Section(cell.title, [Table(header, lines)])


def _cell_json(cell: Cell, claims: Sequence[Claim]) -> dict[str, Any]:
    plan = cell.plan
    return {
        "title": cell.title,
        "robot": plan.robot.name,
        "failure": plan.failure,
        "self_rotation": plan.self_rotation,
        "world": plan.world.model_dump(mode="json"),
        "worlds": plan.worlds,
        "interval_tested": plan.worlds > 1,
        "runs": plan.runs,
        "claims": [
            {"name": name, **asdict(claim), "verdict": claim.verdict}
            for name, claim in zip(NAMES, claims, strict=True)
        ],
    }
