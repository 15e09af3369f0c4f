"""Pages to print: the tag of the robot, those of the floor, and the board by which a lens is calibrated."""

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from hexctl.errors import InputError, argument
from hexctl.files import write_new
from hexctl.options import Range, check_fields
from hexctl.vision.detection.calibration_board import SQUARE_M, SQUARES, black_squares
from hexctl.vision.detection.tags import FAMILY, HOME_TAG, MODULES, TAG_IDS, tag_modules

Paper = Literal["a4", "letter"]

#: Width and height of the papers, in mm.
PAPERS_MM = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}

#: Length of the bar that a user measures, in mm.
BAR_MM = 100.0

#: Printers leave an edge of this width white, in mm.
MARGIN_MM = 6.0

#: Height of the lines of text at a tag, and of the bar with its text, in mm.
_STRIP_MM, _BAR_STRIP_MM = 7.0, 14.0

_MM = 72 / 25.4

Rectangle = tuple[float, float, float, float]


#: Plausible lengths of the printed bar, tag numbers and tag edges.
BAR_LENGTH_MM = Range(low=50, high=200, unit="mm")
TAG = Range(low=TAG_IDS[0], high=TAG_IDS[-1], whole=True)
EDGE_MM = Range(low=20, high=200, unit="mm")
FLOOR_TAGS = Range(low=0, high=20, whole=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """Tags and paper of a printed sheet.

    Raises InputError for unknown or repeated tag numbers and for tags larger than the paper.
    """

    paper: Paper = "a4"
    """Paper: a4 or letter."""

    robot_tag: Annotated[int, TAG] = 10
    """Number of the robot's tag, a whole number, {}, and none of the floor's."""

    robot_edge_mm: Annotated[float, EDGE_MM] = 100.0
    """Edge of the robot's tag in millimetres, {}."""

    home_edge_mm: Annotated[float, EDGE_MM] = 110.0
    """Edge of the floor's tag 0 in millimetres, {}. Its middle is the origin of the floor."""

    floor_tags: Annotated[int, FLOOR_TAGS] = 3
    """Further tags on the floor, numbered from 1, a whole number, {}."""

    floor_edge_mm: Annotated[float, EDGE_MM] = 160.0
    """Edge of further tags in millimetres, {}."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.robot_tag <= self.floor_tags:
            raise InputError(
                f"{argument('robot_tag')}: got {self.robot_tag}; "
                f"allowed: {self.floor_tags + 1} to {TAG_IDS[-1]}, which is no tag of the floor"
            )
        for name, strips_mm in (
            ("robot_edge_mm", 0.0),
            ("home_edge_mm", 0.0),
            ("floor_edge_mm", 2 * _STRIP_MM),
        ):
            edge_mm, most_mm = getattr(self, name), self._most_edge_mm(strips_mm)
            if edge_mm > most_mm:
                raise InputError(
                    f"{argument(name)}: got {edge_mm:g}; allowed: {EDGE_MM.low} to {most_mm:.0f} mm on "
                    f"{self.paper}"
                )

    def _most_edge_mm(self, strips_mm: float) -> float:
        """Edge of the largest tag on a page; its white edge may reach into the printer's."""
        width_mm, height_mm = PAPERS_MM[self.paper]
        high_mm = height_mm - 2 * MARGIN_MM - _BAR_STRIP_MM - 2 * _STRIP_MM - strips_mm
        return min(width_mm, high_mm) * MODULES / (MODULES + 2)

    @property
    def floor_edges_mm(self) -> dict[int, float]:
        """Edges of the floor's tags, by number."""
        further = range(HOME_TAG + 1, HOME_TAG + 1 + self.floor_tags)
        return {HOME_TAG: self.home_edge_mm} | dict.fromkeys(further, self.floor_edge_mm)

    def pdf(self) -> bytes:
        """The pages, all squares as vectors: first robot and home, then the floor, then the board."""
        from reportlab.pdfgen.canvas import Canvas

        width_mm, height_mm = PAPERS_MM[self.paper]
        content = io.BytesIO()
        canvas = Canvas(content, pagesize=(width_mm * _MM, height_mm * _MM), invariant=True)
        canvas.setTitle("hexctl: tags and calibration board")
        page = _Page(canvas, width_mm, height_mm)
        self._first_pages(page)
        for tag_id in range(HOME_TAG + 1, HOME_TAG + 1 + self.floor_tags):
            top_mm = _floor_page(page, tag_id, self.floor_edge_mm)
            page.text(page.width_mm / 2, top_mm, _floor_text(tag_id, self.floor_edge_mm), middle=True)
            page.text(
                page.width_mm / 2, top_mm + 5, "Lay it flat anywhere in view; tape it down.", middle=True
            )
            page.finish()
        _board_page(page)
        canvas.save()
        return content.getvalue()

    def _first_pages(self, page: "_Page") -> None:
        """The robot's tag and the home tag, on one page where both fit."""
        below_mm = _robot_part(page, self.robot_tag, self.robot_edge_mm)
        quiet_mm = self.home_edge_mm / MODULES
        if below_mm + self.home_edge_mm + quiet_mm + max(quiet_mm, MARGIN_MM) > page.height_mm:
            page.bar(page.height_mm - MARGIN_MM)
            page.finish()
            below_mm = MARGIN_MM
        _home_part(page, below_mm, self.home_edge_mm)
        page.finish()


def save_sheet(sheet: Sheet, path: Path) -> None:
    """Write the pages as a new PDF file. Raises InputError for one that exists or cannot be written."""
    write_new(path, sheet.pdf(), argument("output"))


class _Page:
    """A page in mm from its top left corner, as it is read."""

    def __init__(self, canvas: Any, width_mm: float, height_mm: float) -> None:
        self._canvas, self.width_mm, self.height_mm = canvas, width_mm, height_mm

    def finish(self) -> None:
        self._canvas.showPage()

    def squares(self, rectangles_mm: Iterable[Rectangle]) -> None:
        """Black rectangles (left, top, width, height) as one shape, so that no seams show between them."""
        path = self._canvas.beginPath()
        for left, top, width, height in rectangles_mm:
            path.rect(left * _MM, (self.height_mm - top - height) * _MM, width * _MM, height * _MM)
        self._canvas.drawPath(path, stroke=0, fill=1, fillMode=1)

    def tag(self, tag_id: int, left_mm: float, top_mm: float, edge_mm: float) -> None:
        """A tag whose black square has its upper left corner at a point."""
        module_mm = edge_mm / MODULES
        self.squares(
            (left_mm + start * module_mm, top_mm + row * module_mm, count * module_mm, module_mm)
            for row, start, count in _runs(tag_modules(tag_id))
        )

    def line(self, *points_mm: tuple[float, float], dashed: bool = False, width_mm: float = 0.2) -> None:
        self._canvas.setLineWidth(width_mm * _MM)
        self._canvas.setDash([2 * _MM, 2 * _MM] if dashed else [])
        path = self._canvas.beginPath()
        path.moveTo(points_mm[0][0] * _MM, (self.height_mm - points_mm[0][1]) * _MM)
        for x_mm, y_mm in points_mm[1:]:
            path.lineTo(x_mm * _MM, (self.height_mm - y_mm) * _MM)
        self._canvas.drawPath(path, stroke=1, fill=0)

    def arrow(self, left_mm: float, y_mm: float, length_mm: float) -> None:
        end_mm = left_mm + length_mm
        self.line((left_mm, y_mm), (end_mm, y_mm), width_mm=0.8)
        self.line((end_mm - 3, y_mm - 1.8), (end_mm, y_mm), (end_mm - 3, y_mm + 1.8), width_mm=0.8)

    def text(
        self, x_mm: float, y_mm: float, text: str, *, middle: bool = False, size_mm: float = 3.4
    ) -> None:
        """A line of text whose foot is at a height."""
        self._canvas.setFont("Helvetica", size_mm * _MM)
        draw = self._canvas.drawCentredString if middle else self._canvas.drawString
        draw(x_mm * _MM, (self.height_mm - y_mm) * _MM, text)

    def bar(self, bottom_mm: float) -> None:
        """The bar to measure, in the middle of the page, with a tick every 10 mm."""
        left_mm, y_mm = (self.width_mm - BAR_MM) / 2, bottom_mm - 8
        self._ticks([(left_mm + at, y_mm) for at in np.linspace(0, BAR_MM, 11)], (0.0, 1.0))
        self.text(self.width_mm / 2, bottom_mm - 0.5, _BAR_TEXT, middle=True)

    def upright_bar(self, x_mm: float, top_mm: float) -> None:
        """Draw the vertical bar for measuring, with its text."""
        self._ticks([(x_mm, top_mm + at) for at in np.linspace(0, BAR_MM, 11)], (1.0, 0.0))
        for line, text in enumerate(_BAR_LINES):
            self.text(x_mm + 6, top_mm + BAR_MM / 2 - 10 + 5 * line, text)

    def _ticks(self, points_mm: list[tuple[float, float]], across: tuple[float, float]) -> None:
        self.line(points_mm[0], points_mm[-1], width_mm=0.3)
        for number, (x_mm, y_mm) in enumerate(points_mm):
            half_mm = 3.0 if number in (0, len(points_mm) - 1) else 1.2
            self.line(
                (x_mm - half_mm * across[0], y_mm - half_mm * across[1]),
                (x_mm + half_mm * across[0], y_mm + half_mm * across[1]),
                width_mm=0.3,
            )


_BAR_TEXT = "Measure: this bar must be 100 mm long. Print at 100 %, not fitted to the page."
_BAR_LINES = ("Measure: this bar", "must be 100 mm.", "Print at 100 %,", "not fitted to", "the page.")


def _runs(modules: Any) -> Iterator[tuple[int, int, int]]:
    """Runs of black modules of each row, as (row, first column, length)."""
    for row, blacks in enumerate(modules):
        edges = np.flatnonzero(np.diff(np.pad(blacks.astype(int), 1)))
        for start, end in edges.reshape(-1, 2).tolist():
            yield row, start, end - start


def _floor_text(tag_id: int, edge_mm: float) -> str:
    return f"{FAMILY} {tag_id}, floor, black square {edge_mm:g} mm"


def _robot_part(page: _Page, tag_id: int, edge_mm: float) -> float:
    """Draw the robot's tag with its cutting line and the bar; return where it ends, in mm."""
    quiet_mm = edge_mm / MODULES
    side_mm, top_mm = edge_mm + 2 * quiet_mm, MARGIN_MM
    left_mm = MARGIN_MM if side_mm + 50 < page.width_mm else (page.width_mm - side_mm) / 2
    page.tag(tag_id, left_mm + quiet_mm, top_mm + quiet_mm, edge_mm)
    bottom_mm = top_mm + side_mm + _STRIP_MM
    corners = [(left_mm, top_mm), (left_mm + side_mm, top_mm)]
    corners += [(left_mm + side_mm, bottom_mm), (left_mm, bottom_mm), (left_mm, top_mm)]
    page.line(*corners, dashed=True)
    page.text(
        left_mm + 2,
        bottom_mm - 2.5,
        f"robot, {FAMILY} {tag_id}, {edge_mm:g} mm",
        size_mm=min(3.4, side_mm / 20),
    )
    page.text(left_mm + side_mm - 24, bottom_mm - 2.5, "front", size_mm=min(3.4, side_mm / 20))
    page.arrow(left_mm + side_mm - 14, bottom_mm - 3.5, 12)
    if side_mm + 50 < page.width_mm and bottom_mm > BAR_MM + top_mm:
        page.upright_bar(left_mm + side_mm + 12, top_mm + (bottom_mm - top_mm - BAR_MM) / 2)
    return bottom_mm + 2


def _home_part(page: _Page, top_mm: float, edge_mm: float) -> None:
    """Draw the home tag with its axes."""
    quiet_mm = edge_mm / MODULES
    left_mm, upper_mm = max(quiet_mm, MARGIN_MM), top_mm + quiet_mm
    page.tag(HOME_TAG, left_mm, upper_mm, edge_mm)
    middle_mm, beside_mm = upper_mm + edge_mm / 2, left_mm + edge_mm + quiet_mm + 3
    page.arrow(beside_mm, middle_mm, 30)
    page.text(beside_mm, middle_mm - 4, "x of the floor: ahead")
    lines = ("start: the middle of the tag", _floor_text(HOME_TAG, edge_mm).partition(", black")[0])
    for line, text in enumerate((*lines, f"black square {edge_mm:g} mm", "Tape it down, flat.")):
        page.text(beside_mm, middle_mm + 7 + 5 * line, text)


def _floor_page(page: _Page, tag_id: int, edge_mm: float) -> float:
    """One tag of the floor in the middle of a page, and the bar; where text begins below it, in mm."""
    page.bar(page.height_mm - MARGIN_MM)
    quiet_mm = edge_mm / MODULES
    free_mm = page.height_mm - _BAR_STRIP_MM - 2 * _STRIP_MM - MARGIN_MM
    top_mm = (free_mm - edge_mm) / 2
    page.tag(tag_id, (page.width_mm - edge_mm) / 2, top_mm, edge_mm)
    return top_mm + edge_mm + quiet_mm + 5


def _board_page(page: _Page) -> None:
    columns, rows = SQUARES
    left_mm, top_mm = (page.width_mm - columns * SQUARE_M * 1000) / 2, 2 * MARGIN_MM
    page.squares(
        (left_mm + 1000 * left, top_mm + 1000 * top, 1000 * edge, 1000 * edge)
        for left, top, edge in black_squares()
    )
    page.bar(page.height_mm - MARGIN_MM)
    text = "For hexctl see calibrate: glue it onto something flat and stiff."
    page.text(page.width_mm / 2, top_mm + rows * SQUARE_M * 1000 + 7, text, middle=True)
    page.finish()
