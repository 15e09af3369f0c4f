"""`hexctl play`: a simulated robot in the browser."""

import webbrowser
from typing import Any

import typer

from hexctl.backends.clock import realtime_priority
from hexctl.browser.play_options import PlayOptions
from hexctl.cli.console import INTERRUPTED, StopOnInterrupt, print_note
from hexctl.cli.settings import runs_folder
from hexctl.cli.signature import with_options


@with_options(PlayOptions)
def play(asked: dict[str, Any]) -> None:
    """Drive a simulated robot in the browser, break its legs by a click, and see it recover.

    The page is on this computer only. Ctrl-C ends it. Exit codes: 2 bad input, 3 fault, 130 interrupted.
    """
    from hexctl.browser.play import Play
    from hexctl.recording.viewer import has_display

    options = PlayOptions(**asked)
    with StopOnInterrupt() as interrupt, Play(options, runs=runs_folder()) as page:
        print_note(f"open {page.url} in a browser; Ctrl-C ends it")
        if options.open_browser and has_display():
            webbrowser.open(page.url)
        with realtime_priority():
            page.run(interrupt.requested)
    raise typer.Exit(INTERRUPTED)
