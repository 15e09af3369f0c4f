"""A viewer with one recording, on a virtual screen."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pictures.screen import strange_home, virtual_screen
from pictures.window import Window, open_window

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
