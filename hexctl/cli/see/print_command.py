"""`hexctl see print`: the tags of robot and floor, and the board, as pages to print."""

from pathlib import Path
from typing import Annotated, Any

import typer

from hexctl.cli.console import print_result
from hexctl.cli.signature import with_options
from hexctl.vision.sheet import Sheet, save_sheet


@with_options(Sheet, rare=("robot_edge_mm", "home_edge_mm", "floor_edge_mm"))
def print_(
    sheet: dict[str, Any],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="New PDF file; nothing is replaced."),
    ] = Path("sheet.pdf"),
) -> None:
    """Make a PDF with the tags of robot and floor, and a board to calibrate the lens with."""
    save_sheet(Sheet(**sheet), output)
    print_result(f"{output}")
