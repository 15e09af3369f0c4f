"""The matrix of verdicts: every claim of the paper under every reading of what the paper leaves open."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hexctl.backends.sim.world import World
from hexctl.errors import InputError, argument
from hexctl.files import atomic_write
from hexctl.robot.model import Robot
from hexctl.study.landscapes.cache import LandscapeCache
from hexctl.study.landscapes.evaluate import Progress, Silent, check_jobs, evaluate
from hexctl.study.landscapes.landscape import LandscapeSpec
from hexctl.study.landscapes.versions import code_versions
from hexctl.study.reports.figure_style import check_drawing, save_figure
from hexctl.study.reports.figures import verdicts_figure
from hexctl.study.reports.report_page import Picture, Section, Table, render_page
from hexctl.study.searches import search_all
from hexctl.study.study import ReportResult, report_folder
from hexctl.study.study_plan import StudyPlan
from hexctl.study.verdicts.claim_evidence import Claim
from hexctl.study.verdicts.claims import NAMES, claims_of

REPORT = "matrix.html"

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
    plan: StudyPlan

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
class MatrixPlan:
    """Settings of a matrix: its cells."""

    cells: tuple[Cell, ...]

    def specs(self) -> list[LandscapeSpec]:
        """Specs of all landscapes, cell by cell."""
        return [spec for cell in self.cells for spec in self._specs_of(cell)]

    def _specs_of(self, cell: Cell) -> list[LandscapeSpec]:
        specs = cell.plan.specs()
        return [replace(one, place=", ".join(filter(None, (cell.title, one.place)))) for one in specs]

    def check(self) -> None:
        """Raise InputError for anything that is not allowed, before anything runs."""
        for cell in self.cells:
            cell.plan.check()


@dataclass(frozen=True, kw_only=True, eq=False)
class MatrixResult(ReportResult):
    """A finished matrix.

    Attributes:
        plan: its cells.
        claims: claims of each cell, in the order of the cells.
    """

    plan: MatrixPlan
    claims: tuple[tuple[Claim, ...], ...]

    def numbers(self) -> dict[str, Any]:
        """Verdicts of the cells, as plain JSON values."""
        return {
            "code": code_versions(),
            "cells": [
                _cell_json(cell, some) for cell, some in zip(self.plan.cells, self.claims, strict=True)
            ],
            "survive": [NAMES[row] for row in range(len(NAMES)) if self._everywhere(row)],
        }

    def _everywhere(self, row: int) -> bool:
        """Whether a claim holds in every cell."""
        return all(claims[row].holds is True for claims in self.claims)

    def lines(self) -> list[str]:
        """Table of verdicts in Markdown."""
        return self.to_markdown().splitlines()

    def to_markdown(self) -> str:
        """Table of verdicts in Markdown: a row for each cell, a column for each claim."""
        header = ("setting", "worlds", *NAMES)
        lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
        lines += ["| " + " | ".join(map(_bold, row)) + " |" for row in _rows(self)]
        return "\n".join(lines) + "\n"


def run_matrix(
    plan: MatrixPlan,
    *,
    folder: Path,
    cache: LandscapeCache | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> MatrixResult:
    """Simulate and search all cells, write page, figure, table and `matrix.json`.

    Arguments and errors are those of `run_study`; a call that was interrupted is continued by the next one.
    """
    cache, progress = cache or LandscapeCache(), progress or Silent()
    check_jobs(jobs)
    check_drawing()
    plan.check()
    with report_folder(folder, REPORT):
        cache.probe()
        landscapes = iter(evaluate(plan.specs(), cache, jobs=jobs, dask=dask, progress=progress))
        progress.stage("searches, cell by cell", len(plan.cells))
        claims = []
        for cell in plan.cells:
            claims.append(
                tuple(claims_of(search_all(cell.plan, [next(landscapes) for _ in cell.plan.specs()])))
            )
            progress.step()
        result = MatrixResult(
            plan=plan, claims=tuple(claims), report=folder / REPORT, notes=tuple(cache.notes)
        )
        write_matrix(result)
    return result


def write_matrix(result: MatrixResult) -> None:
    """Write `matrix.json`, `matrix.md`, the figure and the page into the folder of the report."""
    folder = result.report.parent
    atomic_write(folder / "matrix.json", json.dumps(result.to_json(), indent=1))
    atomic_write(folder / "matrix.md", result.to_markdown())
    rows = [(title, verdicts) for title, _, *verdicts in _rows(result)]
    save_figure(verdicts_figure(rows, NAMES), folder, "matrix")
    page = render_page("hexctl study --matrix", "Verdicts on the paper's claims", _sections(result))
    atomic_write(result.report, page)


def _bold(verdict: str) -> str:
    return verdict.replace("does not hold", "**does not hold**")


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


def _rows(result: MatrixResult) -> list[list[str]]:
    """Setting, number of worlds and short verdicts of each cell."""
    return [
        [cell.title, str(cell.plan.worlds), *map(cell.short_verdict, claims)]
        for cell, claims in zip(result.plan.cells, result.claims, strict=True)
    ]


def _sections(result: MatrixResult) -> Iterator[Section]:
    counts = sorted({cell.plan.without_gaits for cell in result.plan.cells})
    how = (
        "Each failed leg of each robot with all gaits. Legs that are one experiment are walked once, and "
        f"without self-rotation {' or '.join(map(str, counts))} gaits. {SINGLE_WORLD} The study's page says "
        "how claims are judged."
    )
    picture = Picture(result.report.parent / "matrix.svg", "One robot, one simulator, one reading.", how)
    yield Section("Verdicts", [picture, Table(("setting", "worlds", *NAMES), _rows(result))])
    header = ("claim of the paper", "holds here if", "measured here", "random numbers", "verdict")
    for cell, claims in zip(result.plan.cells, result.claims, strict=True):
        lines = [(one.claim, one.rule, one.measured, one.null, one.verdict) for one in claims]
        yield Section(cell.title, [Table(header, lines)])
