"""`hexctl demo`: a leg fails during a walk, the robot recovers, and a gait for the other legs is searched."""

import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hexctl.adapt.adapt_options import BUDGET
from hexctl.cli.console import (
    DONE,
    FAULT,
    INTERRUPTED,
    StopOnInterrupt,
    in_flags,
    print_message,
    print_result,
)
from hexctl.cli.settings import runs_folder
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import number
from hexctl.errors import RecordingError
from hexctl.files import check_writable
from hexctl.recording.viewer import has_display
from hexctl.robot.failure import NoticedFailure
from hexctl.robot.failure_grammar import option_of

if TYPE_CHECKING:
    from rich.console import RenderableType

    from hexctl.adapt.sessions.search_session import Session
    from hexctl.demo.rescue import DemoResult
    from hexctl.runs.run import RunResult


def demo(
    budget: Annotated[int, number("--budget", BUDGET, "Most trials of the search, {}.")] = 20,
    no_view: Annotated[
        bool, typer.Option("--no-view", help="Open no window; it is opened only where there is a screen.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Break a leg of a simulated robot in mid-walk, and see it recover.

    The robot walks twice in one world, without recovery and with it; then hexctl adapt searches for the gait
    that goes straight without that leg. Ctrl-C stops it. Exit codes: 0 done, 3 fault, 130 interrupted.
    """
    check_writable(runs_folder())
    begun: list[str] = []
    folders: list[Path] = []
    with StopOnInterrupt(plain=True) as interrupt:
        try:
            result = _run(budget, interrupt, begun, folders, as_json=as_json)
        except KeyboardInterrupt:
            then = f"continue the search with: hexctl adapt --resume {begun[0]}; " if begun else ""
            kept = [f"what was walked until then is under {folder}/" for folder in folders if folder.is_dir()]
            print_message(f"interrupted; {then}{''.join(kept) or 'nothing was recorded'}")
            raise typer.Exit(INTERRUPTED) from None
    if result.interrupted:
        print_message(_what_is_left(result))
        raise typer.Exit(INTERRUPTED)
    if as_json:
        print_result(result.to_dict())
    else:
        print_result(*_ending(result))
    if result.adaptation is not None and result.adaptation.trouble is not None:
        then = f"continue the search with: hexctl adapt --resume {result.adaptation.session.name}"
        print_message(f"{in_flags(result.adaptation.trouble)}; {then}")
        raise typer.Exit(FAULT)
    raise typer.Exit(DONE if no_view or as_json else _show(result))


def _what_is_left(result: "DemoResult") -> str:
    walks = " ".join(shlex.quote(str(path)) for path in result.recordings)
    if not walks:
        return "interrupted before the search: nothing was recorded"
    seen = f"; look at it with: {_view_command()} {walks}"
    if result.adaptation is None:
        return f"interrupted before the search; what was walked is under {result.folder}/{seen}"
    name = result.adaptation.session.name
    return (
        f"interrupted; continue the search with: hexctl adapt --resume {name}; both walks are under "
        f"{result.folder}/{seen}"
    )


def _view_command() -> str:
    return "hexctl view" if has_display() else "hexctl view --web"


def _run(
    budget: int, interrupt: StopOnInterrupt, begun: list[str], folders: list[Path], *, as_json: bool
) -> "DemoResult":
    """Print each result; `begun` gets the name of the session, `folders` the folder, for an interrupt."""
    from hexctl.adapt.search_progress import SearchBar
    from hexctl.demo import rescue

    said: list[str] = []

    def walked(walk: "RunResult") -> None:
        said.append(_walk_line(walk, recovered=bool(said)))
        if not as_json:
            print_result(said[-1])
            if len(said) == 2:
                print_result(_search_line(budget))

    if not as_json:
        event = rescue.EVENT
        print_result(
            f"World {rescue.WORLD}, which no prior and no threshold of hexctl was made with.",
            f"{rescue.ROBOT} walks for {rescue.WALK_S:g} s. Leg {event.leg} is {event.failure} from "
            f"{event.at_s:g} s on.",
        )
    with SearchBar(hidden=as_json) as bar:

        def begin(session: "Session") -> None:
            begun.append(session.name)
            bar.begin(session)

        return rescue.demo(
            budget=budget,
            folder=runs_folder(),
            note=print_message,
            on_folder=folders.append,
            on_walk=walked,
            on_begin=begin,
            on_stored=bar.advance,
            stop_requested=interrupt.requested,
        )


def _search_line(budget: int) -> str:
    from hexctl.demo import rescue

    event = rescue.EVENT
    assert event.failure is not None  # noqa: S101  it breaks a leg
    option, value = option_of(event.failure)
    return (
        f"Searching a gait that goes straight without leg {event.leg} and without feedback:\n"
        f"  hexctl adapt --{option.replace('_', '-')} {value} --budget {budget} \\\n"
        f"    --world {rescue.WORLD}"
    )


def _walk_line(walk: "RunResult", *, recovered: bool) -> str:
    from hexctl.demo.rescue import share_in_words, speed_kept

    outcome, kept = walk.outcome, speed_kept(walk)
    line = (
        f"  {'with' if recovered else 'without'} recovery: {outcome['distance_m']:.2f} m, keeps "
        f"{share_in_words(kept) if math.isfinite(kept) else 'an unknown share'} of its speed, "
        f"ends {100 * outcome['deviation_m']['final']:.1f} cm off its line"
    )
    noticed = map(NoticedFailure.from_dict, outcome["noticed"])
    return "\n".join(
        [line, *(f"    leg {one.failure.leg} detected at {one.at_s:.1f} s; {one.did}" for one in noticed)]
    )


def _ending(result: "DemoResult") -> "list[RenderableType]":
    from hexctl.cli.render.session_summary import finding_parts

    search = result.adaptation
    assert search is not None  # noqa: S101  it was not interrupted
    picture = f"{result.picture}" if result.picture is not None else f"none: {result.no_picture}"
    return [
        *finding_parts(search.session),
        f"both walks as a GIF: {picture}",
        "next:",
        f"  {_view_command()} {shlex.quote(str(result.recordings[-1]))}",
        f"  hexctl sessions show {search.session.name}",
        f"  hexctl run --failure 2:limp@4{' --realtime --view' if has_display() else ''}",
    ]


def _show(result: "DemoResult") -> int:
    """A missing screen does not make the demo a failure."""
    from hexctl.adapt.sessions.session_viewing import view_runs

    search = result.adaptation
    assert search is not None  # noqa: S101  it was not interrupted
    if not has_display():
        return DONE  # the last line of the result is the next step
    try:
        return view_runs([*map(str, result.recordings), search.session.name], runs_folder())
    except RecordingError as error:
        print_message(error)
        return DONE
