"""`hexctl view`: open recordings and sessions in Rerun."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.console import DONE, LeftOut, StopOnInterrupt, note_refusal, print_message, print_note
from hexctl.cli.settings import runs_folder
from hexctl.cli.signature import with_options
from hexctl.errors import InputError, RecordingError, RobotFaultError
from hexctl.wire.connection_diagnosis import RefusalWatch
from hexctl.wire.links import WatchOptions, load_link

if TYPE_CHECKING:
    from hexctl.robot.meshes import Meshes


@with_options(WatchOptions)
def view(
    place: dict[str, Any],
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="RECORDING|SESSION",
            autocompletion=completion.viewable,
            help="Recordings (.rrd) or names of sessions. (default: the newest under runs/)",
        ),
    ] = None,
    web: Annotated[
        bool, typer.Option("--web", help="Serve the viewer to a browser on this computer, until Ctrl-C.")
    ] = False,
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Show the robot behind --connect in a page that cannot move it, until Ctrl-C."
        ),
    ] = False,
    picture: Annotated[
        str | None,
        typer.Option(
            "--picture",
            metavar="URL",
            hidden=True,
            help="With --live, show a camera: the URL of its stream or picture. (default: none)",
        ),
    ] = None,
) -> None:
    """Open recordings or sessions in the Rerun viewer until it is closed, or watch a robot.

    Damaged recordings and trials of a session are named on stderr, with exit code 3; the others are shown.
    """
    if picture is not None and not live:
        raise InputError("--picture requires --live; allowed: with --connect and --live")
    if place["connect"] is None and place["link"] is None:
        if live:
            raise InputError("--live: got no robot to show; allowed: with --connect or --link")
        if place["credentials"] is not None or place["insecure"]:
            raise InputError("--keys, --insecure: got one without --connect or --link; allowed: with a robot")
        raise typer.Exit(_view_runs(names or [], web=web))
    if names:
        raise InputError(f"view: got {names[0]!r} with a robot; allowed: recordings, or --connect, not both")
    if live and web:
        raise InputError("--web: got --live too; allowed: one of them")
    raise typer.Exit(_show_live(place, picture) if live else _watch(place, web=web))


def _view_runs(names: list[str], *, web: bool) -> int:
    from hexctl.adapt.sessions.session_viewing import serve_runs, view_runs

    left_out = LeftOut()
    if not web:
        return left_out.code(view_runs(names, runs_folder(), on_damage=left_out.name))
    with StopOnInterrupt(plain=True) as interrupt:
        serve_runs(
            names,
            runs_folder(),
            on_url=_print_address,
            stop_requested=interrupt.requested,
            on_damage=left_out.name,
        )
    return left_out.code()


def view_afterwards(*names: str) -> None:
    """Open recordings and sessions that a command has made; a missing screen does not make it a failure."""
    from hexctl.adapt.sessions.session_viewing import view_runs

    try:
        view_runs(names, runs_folder())
    except RecordingError as error:
        print_message(error)


def _watch(place: dict[str, Any], *, web: bool) -> int:
    from hexctl.backends.zenoh.zenoh_client import subscribe_states
    from hexctl.recording.live import LiveView, watch_states
    from hexctl.recording.viewer import check_display

    loaded = load_link(**place)
    watch = RefusalWatch(loaded.endpoint, note_refusal)
    with watch, subscribe_states(loaded) as (robot, states), StopOnInterrupt(plain=True) as interrupt:
        if not web:
            check_display()
        with LiveView(web=web) as live:
            if live.url is not None:
                _print_address(live.url)
            try:
                watch_states(
                    live,
                    robot,
                    states.newest,
                    place=loaded.endpoint,
                    stop_requested=interrupt.requested,
                    failures=lambda: states.failures,
                )
            except RobotFaultError:
                # A window keeps its content; a browser needs the server.
                live.close(leave_viewer=not web)
                raise
            live.close(leave_viewer=False)
    return DONE


def _show_live(place: dict[str, Any], picture: str | None) -> int:
    from hexctl.backends.zenoh.zenoh_client import subscribe_states
    from hexctl.browser.live_page import LivePage

    loaded = load_link(**place)
    watch = RefusalWatch(loaded.endpoint, note_refusal)
    with (
        watch,
        subscribe_states(loaded) as (robot, states),
        StopOnInterrupt(plain=True) as interrupt,
        LivePage(robot, _meshes_of(robot.name), place=loaded.endpoint, picture_url=picture) as page,
    ):
        _print_address(page.url)
        page.watch(states.newest, stop_requested=interrupt.requested, failures=lambda: states.failures)
    return DONE


def _meshes_of(name: str) -> "Meshes":
    """Meshes of a shipped robot; a served robot's own file is not here."""
    from hexctl.robot.configs import config_names
    from hexctl.robot.loader import load_meshes

    return load_meshes(name) if name in config_names("robots") else {}


def _print_address(url: str) -> None:
    print_note(f"open {url} in a browser; Ctrl-C ends it")
