"""`hexctl calibrate`: sign, offset and limits of each servo, one at a time."""

import os
import select
import sys
from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli.console import DONE, INTERRUPTED, StopOnInterrupt, print_note
from hexctl.cli.options import InsecureOption


def calibrate(
    robot: Annotated[str, typer.Argument(help="Robot file (YAML) to write to; copy a shipped one first.")],
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            help="What moves: mavlink (a servo board), or package.module:Class for servos of your own that "
            "have a servo map.",
        ),
    ] = "mavlink",
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            help="Where the servo board is: udpout:HOST:PORT, or a serial device such as "
            "/dev/ttyACM0:115200. (default: udpout:127.0.0.1:14550)",
        ),
    ] = None,
    joints: Annotated[
        str | None,
        typer.Option(
            "--joints", help="Only these joints, such as leg1_coxa,leg2_tibia or leg3. (default: all 18)"
        ),
    ] = None,
    keys: Annotated[
        Path | None,
        typer.Option(
            "--keys",
            help="Folder with mavlink.key, the board's secret, for a board that "
            "obeys it only. (default: none)",
        ),
    ] = None,
    insecure: InsecureOption = False,
) -> None:
    """Find direction, offset and limits of each servo, and write them to the robot file.

    Hold the robot so that its legs hang free. Every joint is saved when it is done; Ctrl-C ends it.
    """
    from hexctl.control.calibration import calibrate as calibrate_servos

    with StopOnInterrupt() as interrupt:
        result = calibrate_servos(
            robot,
            Terminal(),
            backend=backend,
            joints=joints,
            connect=connect,
            credentials=keys,
            insecure=insecure,
            stop_requested=interrupt.requested,
        )
        if interrupt.requested():
            print_note("")  # the prompt is still on the line
        saved = f"saved {', '.join(result.saved)} in {result.path}" if result.saved else "nothing was changed"
        before = "" if result.backup is None else f"; as it was before: {result.backup}"
        print_note(saved + before)
        raise typer.Exit(INTERRUPTED if interrupt.requested() else DONE)


class Terminal:
    """An operator at a terminal or a pipe: questions on stderr, answers in lines, never waited for."""

    def __init__(self) -> None:
        self._waiting = b""
        self._ended = False

    def tell(self, text: str) -> None:
        """Print a line."""
        print_note(text)

    def prompt(self, text: str) -> None:
        """Print a question and stay on its line."""
        sys.stderr.write(f"{text} ")
        sys.stderr.flush()

    def poll(self) -> str | None:
        """The next whole line without its end, or None while there is none.

        Raises EndedError after the last line of an input that has ended.
        """
        from hexctl.control.calibration import EndedError

        descriptor = sys.stdin.fileno()
        while b"\n" not in self._waiting:
            if self._ended:
                print_note("")
                raise EndedError
            if not select.select([descriptor], [], [], 0)[0]:
                return None
            data = os.read(descriptor, 4096)
            self._ended = not data
            self._waiting += data or (b"\n" if self._waiting else b"")
        line, self._waiting = self._waiting.split(b"\n", 1)
        if not os.isatty(descriptor):
            print_note("")  # no key ended the line on the screen
        return line.decode("utf-8", errors="replace").strip()
