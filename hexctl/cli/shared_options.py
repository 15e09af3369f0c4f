"""Options of several commands: output, recording, `--recover`, and `--arena`."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.console import print_message
from hexctl.cli.settings import runs_folder
from hexctl.cli.signature import checked
from hexctl.errors import InputError
from hexctl.options import Range

if TYPE_CHECKING:
    from hexctl.adapt.arena import Geofence

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value on stdout and nothing else.")]

QuietOption = Annotated[bool, typer.Option("--quiet", "-q", hidden=True, help="Print the end only.")]

NoRecordOption = Annotated[bool, typer.Option("--no-record", hidden=True, help="Leave no recording.")]


def record_folder(record: object, *, no_record: bool) -> Path | None:
    """Folder of a recording without a name, if one is left; raises InputError for --no-record with a name."""
    if no_record and record is not None:
        raise InputError("--no-record: got --record too; allowed: one or the other")
    return None if no_record or record is not None else runs_folder()


def _recover(text: str, *, rare: bool) -> Any:
    return typer.Option(
        "--recover", rich_help_panel="Failure", hidden=rare, help=f"{text}: --recovery glide."
    )


RecoverOption = Annotated[
    bool,
    _recover("Walk on without a leg that fails, on the same line, the default in simulation", rare=False),
]
TrialRecoverOption = Annotated[
    bool, _recover("If another leg fails during a trial, walk the trial to its end without it", rare=True)
]


def chosen_recovery(*, recover: bool, recovery: str | None) -> str | None:
    """The recovery by `--recover` or `--recovery`; raises InputError if they contradict."""
    if recover and recovery not in (None, "glide"):
        raise InputError(f"--recovery: got {recovery} with --recover, which is glide; allowed: one of them")
    return "glide" if recover else recovery


METRES = Range(low=0, above=True, unit="m")


def arena_of(text: str | float | Path) -> float | Path:
    """Radius in m, or the file of a place; raises ValueError for anything else."""
    if isinstance(text, Path):
        return text
    if isinstance(text, str) and text.endswith((".yaml", ".yml")):
        return Path(text)
    try:
        float(text)
    except ValueError:
        raise ValueError(
            f"got {text!r}; allowed: a number, above 0 m, or a file of hexctl see, such as place.yaml"
        ) from None
    return METRES.parse(text)


def _arena(text: str) -> Any:
    return typer.Option("--arena", hidden=True, parser=checked(arena_of), metavar="METRES|FILE", help=text)


ArenaOption = Annotated[
    Any,
    _arena(
        f"If the robot stays where a walk ends: the radius in metres, {METRES}, around its start "
        "that it is kept in; or the place file of hexctl see, for the largest circle that "
        "its camera sees. (default: none, it wanders)"
    ),
]
WalkArenaOption = Annotated[
    Any,
    _arena(
        f"Stop softly before leaving a circle: the radius in metres, {METRES}, around the start of the walk; "
        "or the place file of hexctl see, for the largest circle that its camera sees. (default: none)"
    ),
]


def geofence(arena: float | Path, robot: str, *, simulated: bool) -> "Geofence":
    """Ends a walk at the edge of an arena; raises InputError for bad files and for a simulation."""
    from hexctl.adapt.arena import Arena, Geofence

    if not isinstance(arena, Path):
        return Geofence(arena)
    if simulated:
        raise InputError(f"--arena: got {arena} with --backend sim; allowed: a radius, or another --backend")
    fields = arena_fields(arena, robot)
    return Geofence(Arena(home_m=tuple(fields["home_m"]), radius_m=fields["arena_m"]))


def arena_fields(arena: float | Path | None, robot: str | None) -> dict[str, Any]:
    """Fields of a session's spec for an arena, reported on stderr; raises InputError for bad files."""
    if arena is None:
        return {}
    if not isinstance(arena, Path):
        return {"arena_m": arena}
    from hexctl.robot.loader import load_robot
    from hexctl.robot.plugins import find_plugin

    if (reader := find_plugin("arenas", "place")) is None:
        raise InputError(f"--arena: got {arena}; allowed: a radius, because hexctl.vision is not installed")
    (x_m, y_m), radius_m = reader.load()(arena, load_robot(robot or "ant"))
    radius_m = math.floor(100 * radius_m) / 100
    print_message(
        f"the robot is kept within {radius_m:g} m of {x_m:.2f}, {y_m:.2f} m, where the camera of "
        f"{arena} sees it"
    )
    return {"arena_m": radius_m, "home_m": [round(x_m, 3), round(y_m, 3)]}
