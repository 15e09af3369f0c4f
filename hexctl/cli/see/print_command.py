"""`hexctl see print`: the tags of robot and floor, and the board, as pages to print."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from hexctl.cli.see.see_options import (
    FloorEdgeOption,
    FloorTagsOption,
    HomeEdgeOption,
    RobotEdgeOption,
    RobotTagOption,
)
from hexctl.cli.values import choice

Paper = Literal["a4", "letter"]


def print_(
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="New PDF file; nothing is replaced."),
    ] = Path("sheet.pdf"),
    paper: Annotated[Paper, choice("--paper", Paper, "Paper: a4 or letter.")] = "a4",
    robot_tag: RobotTagOption = 10,
    robot_edge_mm: RobotEdgeOption = 100.0,
    home_edge_mm: HomeEdgeOption = 110.0,
    floor_tags: FloorTagsOption = 3,
    floor_edge_mm: FloorEdgeOption = 160.0,
) -> None:
    """Make a PDF with the tags of robot and floor, and a board to calibrate the lens with."""
    from hexctl.cli.console import print_result
    from hexctl.vision.sheet import Sheet, save_sheet

    sheet = Sheet(
        paper=paper,
        robot_tag=int(robot_tag),
        robot_edge_mm=robot_edge_mm,
        home_edge_mm=home_edge_mm,
        floor_tags=int(floor_tags),
        floor_edge_mm=floor_edge_mm,
    )
    save_sheet(sheet, output)
    print_result(f"{output}")
