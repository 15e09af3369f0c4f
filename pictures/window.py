"""Rerun's own viewer on a screen, controlled from here, and what it shows."""

import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hexctl.recording.rrd import load_rerun
from hexctl.recording.viewer import LOCAL, free_port, viewer_binary
from pictures.needed import MissingProgramError
from pictures.picture import Picture
from pictures.screen import strange_home, virtual_screen

#: How long the viewer may take for anything, on a slow machine without a graphics card.
TIMEOUT_S = 60.0
POLL_S = 0.1

#: Two pictures one after the other that differ less are the same: the cursor of a text field blinks.
SETTLED = 1e-4


class Window:
    """A viewer that is open."""

    def __init__(self, client: Any, process: "subprocess.Popen[bytes]") -> None:
        self._client, self._process = client, process

    @property
    def state(self) -> Any:
        """State of the viewer: recordings, views, what it is loading."""
        return self._client.get_state()

    @property
    def views(self) -> list[Any]:
        """Views that are laid out: name, class, reported problems."""
        return list(self.state.views)

    def await_shown(self) -> None:
        """Wait until something is laid out and nothing is being loaded."""
        self._wait(lambda: self.state.views and not self.state.loading, "nothing is laid out")

    def await_view(self, name: str) -> None:
        """Wait until a view is laid out."""
        self._wait(lambda: name in [view.name for view in self.views], f"no view {name!r}")

    def open(self, url: str) -> None:
        """Open another recording, as a click on a link to it does."""
        self._client.open(url)

    def show_time(self, time_s: float) -> None:
        """Stop a trial at a time."""
        self._client.set_time("trial_time", duration=time_s, play_state="paused")

    def picture(self) -> Picture:
        """Screenshot of the window once it no longer changes; blank ones are taken again."""
        deadline_s = time.monotonic() + TIMEOUT_S
        before, now = self._taken(), self._taken()
        while (now.blank or now.difference(before) > SETTLED) and time.monotonic() < deadline_s:
            time.sleep(POLL_S)
            before, now = now, self._taken()
        if now.blank:
            raise RuntimeError("the viewer: its picture stays blank")
        return now

    def part(self, view: Any) -> Picture | None:
        """Screenshot of one view as it is now; None for a hidden one, such as a tab in the background."""
        try:
            return self._taken(view.view_id)
        except ConnectionError as error:
            if "NotFound" not in str(error):
                raise
            return None

    def _taken(self, view_id: str | None = None) -> Picture:
        return Picture.from_png(self._client.take_screenshot(view_id))

    def _wait(self, done: Callable[[], Any], otherwise: str) -> None:
        deadline_s = time.monotonic() + TIMEOUT_S
        while time.monotonic() < deadline_s:
            if self._process.poll() is not None:
                raise RuntimeError(f"the viewer ended with {self._process.returncode}")
            with suppress(RuntimeError, ConnectionError):
                if done():
                    return
            time.sleep(POLL_S)
        raise RuntimeError(f"the viewer: {otherwise}")


@contextmanager
def open_window(
    paths: Sequence[Path], size: tuple[int, int], screen: str, home: Mapping[str, str], *options: str
) -> Iterator[Window]:
    """Open files in a viewer until the block ends.

    Args:
        paths: recordings and layouts.
        size: of the window, in points.
        screen: the X display.
        home: the environment of `strange_home`.
        options: more of Rerun's own.

    Raises MissingProgramError where the viewer does not start.
    """
    port = free_port()
    errors = Path(home["HOME"], "viewer.txt")
    command = [str(viewer_binary()), "--bind", LOCAL, "--port", str(port), *options]
    command += ["--window-size", "x".join(map(str, size)), *map(str, paths)]
    with errors.open("wb") as sink:
        process = subprocess.Popen(
            command,
            # Without its warnings, which it would show on top of everything.
            env={**home, "DISPLAY": screen, "RUST_LOG": "error"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=sink,
        )
    try:
        yield Window(_connect(process, port, errors), process)
    finally:
        process.kill()
        process.wait()


def _connect(process: "subprocess.Popen[bytes]", port: int, errors: Path) -> Any:
    """Client of a viewer, once it answers."""
    load_rerun()
    from rerun.experimental import ViewerClient

    deadline_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline_s and process.poll() is None:
        with suppress(RuntimeError, ConnectionError, ValueError):
            client = ViewerClient.connect(f"rerun+http://{LOCAL}:{port}/proxy")
            client.get_state()
            return client
        time.sleep(POLL_S)
    said = errors.read_text(errors="replace").splitlines()
    raise MissingProgramError(f"a viewer that starts ({said[-1] if said else 'it says nothing'})")


#: Size of the window in points, and height of its title bar, which names the computer.
SIZE = (1280, 760)
BAR = 37


@contextmanager
def opened(path: Path) -> Iterator[Window]:
    """Open a recording until the block ends; raises MissingProgramError where nothing can be shown."""
    with (
        strange_home() as home,
        virtual_screen(SIZE) as screen,
        open_window([path], SIZE, screen, home) as window,
    ):
        window.await_shown()
        yield window
