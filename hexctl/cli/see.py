"""`hexctl see`: a camera over the floor; the sheets it needs, and its lens."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from hexctl.cli.values import Range, choice, number

Paper = Literal["a4", "letter"]

TAG = Range(low=0, high=586, whole=True)
EDGE_MM = Range(low=20, high=200, unit="mm")
FLOOR_TAGS = Range(low=0, high=20, whole=True)

see = typer.Typer(help="Find a robot on the floor with a camera and printed tags.", no_args_is_help=True)


@see.command("print")
def print_(
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="New PDF file; nothing is replaced."),
    ] = Path("sheet.pdf"),
    paper: Annotated[Paper, choice("--paper", Paper, "Paper: a4 or letter.")] = "a4",
    robot_tag: Annotated[
        int,
        number("--robot-tag", TAG, "Number of the robot's tag, a whole number, {}, and none of the floor's."),
    ] = 10,
    robot_edge_mm: Annotated[
        float, number("--robot-edge-mm", EDGE_MM, "Edge of the robot's tag in millimetres, {}.")
    ] = 100.0,
    home_edge_mm: Annotated[
        float, number("--home-edge-mm", EDGE_MM, "Edge of the floor's tag 0 in millimetres, {}.")
    ] = 110.0,
    floor_tags: Annotated[
        int,
        number(
            "--floor-tags", FLOOR_TAGS, "Further tags for the floor, one on each page, a whole number, {}."
        ),
    ] = 3,
    floor_edge_mm: Annotated[
        float, number("--floor-edge-mm", EDGE_MM, "Edge of these in millimetres, {}.")
    ] = 160.0,
) -> None:
    """Make a PDF with the tags of robot and floor, and a board to calibrate the lens with."""
    from hexctl.cli.console import print_result
    from hexctl.see.sheet import Sheet, save_sheet

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
