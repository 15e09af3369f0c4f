"""Links that are lost: a robot in another process, walked over Zenoh by a drive that goes or is cut off."""

import random
import signal
import time
from contextlib import ExitStack
from pathlib import Path

from hexctl.control.controllers import SITTING_S
from hexctl.waiting import wait_for
from tests.cli.stopping.drives import PATIENCE_S, Driven, Pad, Process
from tests.server.processes import Cable, served

#: How long after a robot has stood up it walks for certain.
STOOD_S = 0.3


class LinkDriven(Driven):
    """Driven with a gamepad over a link.

    Args:
        how: `released`; `killed` or `stopped`, the drive by SIGKILL or SIGSTOP; `held`, the cable takes what
            is sent and passes nothing on, as a pulled plug does; `cut`, it closes the connections.
    """

    def __init__(self, folder: Path, chance: random.Random, how: str) -> None:
        super().__init__(folder, chance)
        self._how = how
        self._stack, self._drives = ExitStack(), ExitStack()
        self._drive: Process | None = None

    def begin(self) -> None:
        """Serve the robot."""
        # It does not sit down while it waits for the next drive.
        self._robot = self._stack.enter_context(served(self.folder, "--sit-after", "3600", name="served"))
        self.servos = type(self.servos)(self._robot.log_path)
        self._pad = Pad(self.folder / "pad", pipe=True)
        self._pad.plug_in()
        self._stack.callback(self._pad.plug_out)

    def end(self) -> None:
        """End all."""
        self._drives.close()
        self._stack.close()

    def alive(self) -> bool:
        """Whether the drive goes on."""
        return self._drive is not None and self._drive.alive()

    def said(self) -> str:
        """What the drive has printed."""
        return "" if self._drive is None else self._drive.said()

    def command(self) -> None:
        """Start the drive where there is none, hold the button, and push the sticks."""
        if self._drive is None:
            self._cable = self._drives.enter_context(Cable(self._robot.endpoint))
            link = ("--backend", "zenoh", "--connect", self._cable.endpoint)
            self._drive = Process(self.folder, self.servos.path, *link, "--gamepad", str(self._pad.path))
            self._drives.callback(self._drive.end)
        self._pad.press(*self.shares())

    def walk(self) -> None:
        """Command, and wait until it walks: a drive that has just begun stands the robot up first."""
        if self._drive is None:
            began_s = time.monotonic()
            self.command()
            wait_for(
                lambda: self.servos.told_after(began_s) or not self.alive(), PATIENCE_S, "no targets come"
            )
            time.sleep(SITTING_S + STOOD_S)
        super().walk()

    def cause(self) -> float:
        """Let go, or let the link go."""
        assert self._drive is not None
        if self._how == "released":
            return self._pad.release()
        if self._how in ("killed", "stopped"):
            return self._drive.signal(signal.SIGKILL if self._how == "killed" else signal.SIGSTOP)
        return self._cable.cut("hold" if self._how == "held" else "close")

    def again(self) -> None:
        """The next command starts another drive where this one is lost; its pad is let go of."""
        if self._how != "released":
            self._pad.release()
            self._drives.close()
            self._drive = None
