"""Options that say what is printed and recorded, and on what a simulation runs."""

from typing import Annotated

import typer

from hexctl.cli.values import number
from hexctl.options import Range

JOBS = Range(low=1, high=1024, whole=True)

JobsOption = Annotated[
    int | None,
    number("--jobs", JOBS, "Threads that simulate, {}. (default: all cores; with --dask 1)"),
]

DaskOption = Annotated[
    str | None,
    typer.Option(
        "--dask",
        help="Address of a Dask scheduler whose workers simulate: tcp://HOST:PORT. (default: this computer)",
    ),
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]

QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print the end only.")]

NoRecordOption = Annotated[bool, typer.Option("--no-record", help="Leave no recording.")]
