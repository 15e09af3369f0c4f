"""Options of output and recording."""

from typing import Annotated

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value on stdout and nothing else.")]

QuietOption = Annotated[bool, typer.Option("--quiet", "-q", hidden=True, help="Print the end only.")]

NoRecordOption = Annotated[bool, typer.Option("--no-record", hidden=True, help="Leave no recording.")]
