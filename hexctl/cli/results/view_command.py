"""`hexctl view`: open recordings and sessions in Rerun."""

from typing import Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.console import DONE, LeftOut, StopOnInterrupt, note_refusal, print_message, print_note
from hexctl.cli.settings import runs_folder
from hexctl.cli.signature import with_options
from hexctl.errors import InputError, RecordingError, RobotFaultError
from hexctl.wire.connection_diagnosis import RefusalWatch
from hexctl.wire.links import WatchOptions, load_link


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
) -> None:
    """Open recordings or sessions in the Rerun viewer until it is closed, or watch a robot.

    Damaged recordings and trials of a session are named on stderr, with exit code 3; the others are shown.
    """
    if place["connect"] is None and place["link"] is None:
        if place["credentials"] is not None or place["insecure"]:
            raise InputError("--keys, --insecure: got one without --connect or --link; allowed: with a robot")
        raise typer.Exit(_view_runs(names or [], web=web))
    if names:
        raise InputError(f"view: got {names[0]!r} with a robot; allowed: recordings, or --connect, not both")
    raise typer.Exit(_watch(place, web=web))


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


def _print_address(url: str) -> None:
    print_note(f"open {url} in a browser; Ctrl-C ends it")
