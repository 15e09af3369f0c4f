"""`hexctl export`: robots, recordings and sessions in the formats of other programs."""

from typing import Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.console import LeftOut, make_bar, print_message, print_result
from hexctl.cli.progress import WithBar
from hexctl.cli.settings import runs_folder
from hexctl.cli.signature import with_options
from hexctl.export.export_options import ExportOptions
from hexctl.robot.configs import config_names
from hexctl.robot.loader import load_robot_file


@with_options(ExportOptions, rare=("from_s", "duration_s"))
def export(
    options: dict[str, Any],
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="ROBOT|RECORDING|SESSION",
            autocompletion=completion.exportable,
            help="A robot (a name of hexctl robot list, or a YAML file), recordings (.rrd), or the name of a "
            "session. Two recordings race in a GIF or MP4; several make one LeRobot dataset.",
        ),
    ],
) -> None:
    """Write a robot, recordings or a session in a format of other programs.

    Missing or damaged recordings and trials of a session are named on stderr, with exit code 3; the
    others are written.
    """
    from hexctl.export.export import export as write

    left_out = LeftOut()
    with _Progress() as progress:
        path = write(
            *sources,
            folder=runs_folder(),
            on_progress=progress.tell,
            on_damage=left_out.name,
            **options,
        )
    print_result(f"{path}")
    _note_unknown(sources[0])
    raise typer.Exit(left_out.code())


def _note_unknown(source: str) -> None:
    """Note on the values of a robot that were not measured: other formats have no mark for them."""
    if source not in config_names("robots") and not source.endswith((".yaml", ".yml")):
        return
    if unknown := load_robot_file(source).to_measure:
        print_message(f"not measured, which the new file does not show: {', '.join(unknown)}")


class _Progress(WithBar):
    def __init__(self) -> None:
        self._bar = make_bar()
        self._task = self._bar.add_task("written (Ctrl-C stops)", total=None, visible=False)

    def tell(self, done: int, total: int) -> None:
        self._bar.update(self._task, completed=done, total=total, visible=total > 1)
