"""Experiments: simulate walks, summarise them and write a report."""

import json
import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from hexctl.errors import InputError, MissingExtraError, argument
from hexctl.files import atomic_write, write_trouble
from hexctl.study.plan import Plan
from hexctl.study.report_page import Picture, Section, render_page, texts
from hexctl.study.versions import code_versions
from hexctl.study.walking import Progress, Silent, Work

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

FindingsT = TypeVar("FindingsT")


#: Draws a figure; returns None if there is nothing to show.
Drawing = Callable[[], "Figure | None"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Result(Generic[FindingsT]):
    """Result of an experiment.

    Attributes:
        report: the HTML page; tables and figures are files in its folder.
    """

    plan: "Experiment[FindingsT]"
    findings: FindingsT
    report: Path
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values, as in the file next to the report and printed by `--json`."""
        return {
            "out": str(self.report.parent),
            "report": str(self.report),
            **self.plan.numbers(self.findings),
            "notes": list(self.notes),
        }

    def lines(self) -> list[str]:
        """Tables and verdicts, as lines of text."""
        return self.plan.lines(self.findings)


@dataclass(frozen=True, kw_only=True)
class Experiment(Plan, Generic[FindingsT]):
    """Settings of an experiment, with its statistics and report."""

    #: Name of its files, file of its report, and heading of that.
    NAME: ClassVar[str]
    REPORT: ClassVar[str]
    HEADING: ClassVar[str]

    @abstractmethod
    def find(self, work: Work) -> FindingsT:
        """Simulate all walks and summarise them."""

    @abstractmethod
    def numbers(self, findings: FindingsT, /) -> dict[str, Any]:
        """Return settings and results as plain JSON values; null if there is no number."""

    @abstractmethod
    def lines(self, findings: FindingsT, /) -> list[str]:
        """Return tables and verdicts as lines of text."""

    @abstractmethod
    def sections(self, findings: FindingsT, /) -> Iterator[Section]:
        """Return the parts of the report, to which the figures are added."""

    def drawings(self, findings: FindingsT, /) -> Mapping[str, Drawing]:
        """Return the figures of the report, by their name in `captions`."""
        return {}

    def tables(self, findings: FindingsT, /) -> "Mapping[str, DataFrame]":
        """Return the tables to write, by the name of their file without the ending."""
        return {}

    def run(self, folder: Path, work: Work | None = None) -> Result[FindingsT]:
        """Simulate all walks, and write report, figures, tables and a JSON file of the results.

        Args:
            folder: new, empty, or with an earlier report of this kind, which is replaced.

        Raises InputError for a plan, a folder or an address that cannot be used, MissingExtraError without
        the extra `study`, CacheError if walks cannot be saved; all but the last before anything runs.
        """
        work = work or Work()
        check_drawing()
        self.check()
        with report_folder(folder, self.REPORT):
            work.cache.probe()
            findings = self.find(work)
            page = self.write(findings, folder, work.progress)
            result = Result(plan=self, findings=findings, report=page, notes=tuple(work.cache.notes))
            text = json.dumps(result.to_json(), indent=1)
            atomic_write(folder / f"{self.NAME}.json", text)
        return result

    def write(self, findings: FindingsT, folder: Path, progress: Progress | None = None) -> Path:
        """Write tables, figures and the page into a folder; return the path of the page."""
        tables = self.tables(findings)
        for name, table in tables.items():
            table.to_parquet(folder / f"{name}.parquet", index=False)
        figures = _figures(self.drawings(findings), folder, progress or Silent())
        files = ", ".join(f"{name}.parquet" for name in tables)
        beside = f"Next to this page: {files or 'its numbers as JSON'}, and each figure as SVG."
        versions = ", ".join(f"{name} {value}" for name, value in code_versions().items())
        last = Section("Files and versions", [beside, versions])
        page = render_page(self.HEADING, [*self.sections(findings), *figures, last])
        atomic_write(folder / self.REPORT, page)
        return folder / self.REPORT


def _figures(drawings: Mapping[str, Drawing], folder: Path, progress: Progress) -> Iterator[Section]:
    """Draw figures, save each as NAME.svg, and return their parts of the report."""
    import matplotlib as mpl

    progress.stage("figures", len(drawings))
    for name, draw in drawings.items():
        figure, file = draw(), folder / f"{name}.svg"
        if figure is not None:
            with mpl.rc_context({"svg.hashsalt": name}):
                figure.savefig(file, metadata={"Date": None, "Creator": None})
            yield Section(name.replace("_", " ").capitalize(), [Picture(file, **texts("captions")[name])])
        progress.step()


def check_drawing() -> None:
    """Raise MissingExtraError unless figures, tables and reports can be written."""
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError("hexctl study", "study") from error


@contextmanager
def report_folder(folder: Path, report: str) -> Iterator[None]:
    """Create the folder of a report; remove it at the end when nothing was written into it.

    Raises InputError unless it is new, empty, or has an earlier report of the same kind.
    """
    if trouble := write_trouble(folder):
        raise InputError(f"{argument('out')}: {trouble}; allowed: a folder")
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()) and not (folder / report).exists():
        raise InputError(f"{argument('out')}: {folder} holds other things; allowed: a new or empty folder")
    try:
        yield
    finally:
        with suppress(OSError):
            folder.rmdir()


def plain(plan: Plan, *names: str) -> dict[str, Any]:
    """Return some fields of a plan as plain JSON values."""
    values = {name: getattr(plan, name) for name in names}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def where(rows: "DataFrame", **values: object) -> "DataFrame":
    """Return the rows in which columns have given values."""
    for column, value in values.items():
        rows = rows[rows[column] == value]
    return rows


def records(rows: "DataFrame") -> list[dict[str, Any]]:
    """Return the rows as plain JSON values."""
    return [{str(name): json_value(value) for name, value in row.items()} for row in rows.to_dict("records")]


def json_value(value: Any) -> Any:
    """Return a value of a frame for JSON: null for an unknown or infinite number."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
