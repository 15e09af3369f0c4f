"""One owner of a board: a lock that the kernel frees when its process ends, also by SIGKILL.

Serial devices have the lock of their terminal. I2C buses and UDP ports have none that excludes a second
program; for them a process listens on an abstract Unix socket of the board's name, whose peer has an id.
Containers with a network of their own do not see it.
"""

import errno
import os
import socket
import struct
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

from hexctl.errors import RobotFaultError

#: Process, user and group of a peer, as of Linux.
_CREDENTIALS = struct.Struct("3i")


class BoardLock:
    """The right to use a board, until `release` or the end of this process.

    Args:
        what: the board in messages, such as `the I2C bus 1`.
        names: the addresses of the board, each of which one process may hold.

    Raises RobotFaultError that names the process that holds one of them.
    """

    def __init__(self, what: str, names: Iterable[str]) -> None:
        self._sockets: list[socket.socket] = []
        try:
            for name in names:
                self._take(f"\0hexctl-board {name}", what)
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Let others use the board."""
        while self._sockets:
            self._sockets.pop().close()

    def _take(self, address: str, what: str) -> None:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._sockets.append(listener)
        try:
            listener.bind(address)
            listener.listen(1)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise in_use(what, _holder(address)) from error


def in_use(what: str, program: str | None) -> RobotFaultError:
    """Error of a board that another program uses."""
    return RobotFaultError(
        f"{what} is in use by {program or 'another program'}; `hexctl serve` and its keeper hold their port, "
        "and a keeper lets the robot down before it ends"
    )


def program_of(process: int) -> str:
    """Command and id of a process; raises OSError if it has ended."""
    words = Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace").split("\0")
    return f"{_command(words)} (process {process})"


def _command(words: list[str]) -> str:
    if any("hexctl.server.keeper" in word for word in words):
        return "the keeper of a `hexctl serve`"
    names = [Path(word).name for word in words if word]
    for name, after in pairwise(names):
        if name == "hexctl" and not after.startswith("-"):
            return f"`hexctl {after}`"
    return f"`{names[0]}`" if names else "a program"


def _holder(address: str) -> str | None:
    """Program that listens at an abstract socket; None if it has just ended."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(address)
            size = _CREDENTIALS.size
            found = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
            process: int = _CREDENTIALS.unpack(found)[0]
            return "this program" if process == os.getpid() else program_of(process)
        except OSError:
            return None
