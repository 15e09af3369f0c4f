"""`hexctl view`: open a recording in Rerun."""

from pathlib import Path
from typing import Annotated

import typer


def view(
    recordings: Annotated[
        list[Path] | None, typer.Argument(help="Recordings (.rrd).  [default: the newest under runs/]")
    ] = None,
) -> None:
    """Open recordings in the Rerun viewer and wait until it is closed."""
    from hexctl.record.viewer import newest_recording, open_viewer

    raise typer.Exit(open_viewer(recordings or [newest_recording(Path("runs"))]))
