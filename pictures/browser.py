"""A browser without a screen: Chromium of the system, steered by Playwright, WebGL in software."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, sync_playwright

from pictures.needed import MissingProgramError

#: Names that Debian and others give the program.
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")

#: WebGL by software; nothing is fetched from anywhere but this computer.
OPTIONS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
    "--disable-quic",
    "--disable-dev-shm-usage",
)


@contextmanager
def chromium() -> Iterator[Browser]:
    """Run a browser until the block ends; raises MissingProgramError where there is none."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        raise MissingProgramError("chromium")
    with (
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=program, args=OPTIONS) as it,
    ):
        yield it
