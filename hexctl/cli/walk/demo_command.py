"""`hexctl demo`: a leg fails during a walk, the robot recovers, and a gait for the other legs is searched."""

import os
import shlex
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hexctl.adapt.adapt_options import BUDGET
from hexctl.cli.console import (
    FAULT,
    INTERRUPTED,
    StopOnInterrupt,
    in_flags,
    print_message,
    print_result,
)
from hexctl.cli.results.view_command import view_afterwards
from hexctl.cli.settings import runs_folder
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import number
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
    with StopOnInterrupt(plain=True) as interrupt:
        try:
            result = _run(budget, interrupt, as_json=as_json)
        except KeyboardInterrupt:
            print_message(f"interrupted; what was recorded is under {runs_folder()}/")
            raise typer.Exit(INTERRUPTED) from None
    search = result.adaptation
    if result.interrupted or search is None:
        print_message(_what_is_left(result))
        raise typer.Exit(INTERRUPTED)
    print_result(*([result.to_dict()] if as_json else _ending(result, search.session)))
    if search.trouble is not None:
        print_message(f"{in_flags(search.trouble)}; {_next_search(search.session)}")
        raise typer.Exit(FAULT)
    if not (no_view or as_json) and has_display():  # else the last line of the result is the next step
        view_afterwards(*map(str, result.recordings), search.session.name)


def _what_is_left(result: "DemoResult") -> str:
    walks = " ".join(shlex.quote(str(path)) for path in result.recordings)
    if not walks:
        return "interrupted before the search: nothing was recorded"
    seen = f"; look at it with: {_view_command()} {walks}"
    if result.adaptation is None:
        return f"interrupted before the search; what was walked is under {result.folder}/{seen}"
    then = _next_search(result.adaptation.session)
    return f"interrupted; {then}; both walks are under {result.folder}/{seen}"


def _next_search(session: "Session") -> str:
    return f"continue the search with: hexctl adapt --resume {session.name}"


def _view_command() -> str:
    return "hexctl view" if has_display() else "hexctl view --web"


def _run(budget: int, interrupt: StopOnInterrupt, *, as_json: bool) -> "DemoResult":
    """Print each result."""
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
            f"World {rescue.WORLD} is held out: nothing in hexctl was tuned in it.",
            f"{rescue.ROBOT} walks for {rescue.WALK_S:g} s. Leg {event.leg} is {event.failure} from "
            f"{event.at_s:g} s on.",
        )
    with SearchBar(hidden=as_json) as bar:
        return rescue.demo(
            budget=budget,
            folder=runs_folder(),
            note=print_message,
            on_walk=walked,
            on_begin=bar.begin,
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
    outcome = walk.outcome
    line = (
        f"  {'with' if recovered else 'without'} recovery: {outcome['distance_m']:.2f} m, "
        f"ends {100 * outcome['deviation_m']['final']:.1f} cm off its line"
    )
    noticed = map(NoticedFailure.from_dict, outcome["noticed"])
    return "\n".join(
        [line, *(f"    leg {one.failure.leg} detected at {one.at_s:.1f} s; {one.did}" for one in noticed)]
    )


def _ending(result: "DemoResult", session: "Session") -> "list[RenderableType]":
    from hexctl.cli.render.session_summary import finding_parts

    picture = f"{result.picture}" if result.picture is not None else f"none: {result.no_picture}"
    return [
        *finding_parts(session),
        f"both walks as a GIF: {picture}",
        "next:",
        *([f"  source {_activate()}"] if _activate() else []),
        f"  {_view_command()} {shlex.quote(str(result.recordings[-1]))}",
        f"  hexctl sessions show {session.name}",
        f"  hexctl run --failure 5:limp@8{' --realtime --view' if has_display() else ''}",
        "  hexctl play  # drive it in your browser, and break its legs by a click",
    ]


def _activate() -> str | None:
    """Script that puts the command on the path, or None if it is there."""
    script = Path(sys.executable).with_name("activate")
    if shutil.which("hexctl") is not None or not script.is_file():
        return None
    return os.path.relpath(script) if script.is_relative_to(Path.cwd()) else str(script)
