"""A browser without a screen: Chromium, steered through the pipes of its DevTools protocol."""

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pictures.needed import MissingProgramError
from pictures.picture import Picture

#: Names that Debian and others give the program.
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")

#: WebGL by software; nothing is fetched from anywhere but this computer.
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--remote-debugging-pipe",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
)

#: How long the browser may take over one answer; its start includes the disk's.
TIMEOUT_S = 60.0
END_TIMEOUT_S = 10.0


class BrowserError(Exception):
    """The browser refuses, or has ended."""


class Browser:
    """One page of a browser. The protocol is JSON, one message ended by a zero byte after the other."""

    def __init__(self, commands: int, answers: int) -> None:
        """Open a page; the arguments are the ends of the two pipes."""
        self._commands, self._answers = commands, answers
        self._asked = 0
        self._received = b""
        self._session: str | None = None
        self.open()

    def open(self) -> None:
        """Open another page, and turn to it."""
        self._session = None
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def leave(self) -> None:
        """Close the page; `open` opens another."""
        self._ask("Page.close")

    def go(self, url: str) -> None:
        """Go to an address; returns before its page is loaded."""
        self._ask("Page.navigate", url=url)

    def picture(self) -> Picture | None:
        """Screenshot of the page, or None between two pages."""
        try:
            taken = self._ask("Page.captureScreenshot", format="png")
        except BrowserError:
            return None
        return Picture.from_png(base64.b64decode(taken["data"]))

    def value(self, expression: str) -> Any:
        """Value of an expression in the page; raises BrowserError where it throws."""
        answer = self._ask("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in answer:
            raise BrowserError(f"{expression}: {answer['exceptionDetails'].get('text')}")
        return answer["result"].get("value")

    def touch(self, x: float, y: float) -> None:
        """Put a finger down, in points from the upper left."""
        self._ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])

    def lift(self) -> None:
        """Lift the finger."""
        self._ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def close(self) -> None:
        """Ask the browser to end."""
        with suppress(BrowserError, OSError):
            self._session = None
            self._ask("Browser.close")

    def _ask(self, method: str, **params: Any) -> dict[str, Any]:
        self._asked += 1
        command: dict[str, Any] = {"id": self._asked, "method": method, "params": params}
        if self._session is not None:
            command["sessionId"] = self._session
        os.write(self._commands, json.dumps(command).encode() + b"\0")
        deadline_s = time.monotonic() + TIMEOUT_S
        while (answer := self._next(deadline_s)).get("id") != self._asked:
            pass  # an event of the page
        if "error" in answer:
            raise BrowserError(f"{method}: {answer['error']}")
        result: dict[str, Any] = answer["result"]
        return result

    def _next(self, deadline_s: float) -> dict[str, Any]:
        """Next message of the browser."""
        while b"\0" not in self._received:
            ready, _, _ = select.select([self._answers], [], [], max(0.0, deadline_s - time.monotonic()))
            data = os.read(self._answers, 1 << 20) if ready else b""
            if not data:
                raise BrowserError("the browser " + ("ended" if ready else "does not answer"))
            self._received += data
        message, _, self._received = self._received.partition(b"\0")
        content: dict[str, Any] = json.loads(message)
        return content


@contextmanager
def browser(size: tuple[int, int], home: Path) -> Iterator[Browser]:
    """Run a browser with a window of a size in points, which keeps its files in a folder, until the end.

    Raises MissingProgramError where there is none.
    """
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        raise MissingProgramError("chromium")
    to_browser, from_browser = os.pipe(), os.pipe()
    inherited = (to_browser[0], from_browser[1])
    window = f"--window-size={size[0]},{size[1]}"
    # It reads from file descriptor 3 and writes to 4.
    shell = f'exec "$0" "$@" 3<&{inherited[0]} 4>&{inherited[1]}'
    process = subprocess.Popen(
        ["/bin/bash", "-c", shell, program, *OPTIONS, window, f"--user-data-dir={home / 'browser'}"],
        pass_fds=inherited,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"HOME": str(home)},
        start_new_session=True,
    )
    for end in inherited:
        os.close(end)
    try:
        page = Browser(to_browser[1], from_browser[0])
        yield page
        page.close()
        with suppress(subprocess.TimeoutExpired):
            process.wait(END_TIMEOUT_S)
    finally:
        # What is left of it: it has processes of its own.
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        os.close(to_browser[1])
        os.close(from_browser[0])
