"""Hands that are lifted or go, and links that are lost: gamepads, pages, terminals, cables."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path

from hexctl.control.controllers import SITTING_S
from hexctl.waiting import wait_for
from pictures.browser import BrowserError, browser
from tests.cli.stopping.drives import PATIENCE_S, Driven, LostDriveError, Pad, Process, local
from tests.cli.terminals import COMMAND, WITH_TERMINAL, OnTerminal
from tests.server.processes import RECORDED, Cable, served
from tests.server.recorded import VARIABLE

#: How long a browser that has just begun may hang, for up to 0.7 s at a time.
BROWSER_S = 3.0

#: How terminals go.
SIGNALS = {"hangup": signal.SIGHUP, "killed": signal.SIGKILL, "frozen": signal.SIGSTOP}

#: Time in which a terminal that was frozen answers what it was asked meanwhile.
AWAKE_S = 0.4

#: Time in which a robot that is told to stand has begun to.
STANDS_S = 0.4

#: Keys to each heading, at full speed.
HEADINGS = ("w" * 5, "s" * 5, "a" * 5, "d" * 5, "\x1b[D" * 5, "\x1b[C" * 5, "wwwaa", "wwww\x1b[D")


class PadDriven(Driven):
    """Driven with a gamepad: its button let go, or pulled out.

    Args:
        how: `released`, `ended` (its event file reads as ended) or `gone` (reading it is an error).
    """

    def begin(self) -> None:
        self._pad = Pad(self.folder / "pad", pipe=self._how != "gone")
        self._pad.plug_in()
        self.drive = local(self.folder, self.servos, "--gamepad", str(self._pad.path))

    def end(self) -> None:
        super().end()
        self._pad.plug_out()

    def command(self) -> None:
        self._pad.press(*self.shares())

    def cause(self) -> float:
        return self._pad.release() if self._how == "released" else self._pad.plug_out()

    def again(self) -> None:
        if self._how != "released":
            self._pad.plug_in()


class PageDriven(Driven):
    """Driven with the page, by a client of its own process.

    Args:
        how: `released`; `stop`, by its button while the finger stays; `closed`, by the closing handshake;
            `killed`, its process with SIGKILL; or `silent`, with SIGSTOP: its socket stays open.
    """

    _finger: subprocess.Popen[str] | None = None

    def begin(self) -> None:
        self.drive = local(self.folder, self.servos, "--page", "127.0.0.1:0", "--gamepad", "none")
        self.port = self.drive.wait_for(r"127\.0\.0\.1:(\d+)/")[1]
        self.again()

    def end(self) -> None:
        super().end()
        self._leave()

    def command(self) -> None:
        self._tell("v {:.3f} {:.3f} {:.3f}".format(*self.shares()))

    def cause(self) -> float:
        assert self._finger is not None
        now_s = time.monotonic()
        if self._how == "released":
            self._tell("release")
        elif self._how in ("stop", "closed"):
            self._tell("stop" if self._how == "stop" else "close")
        else:
            self._finger.send_signal(signal.SIGKILL if self._how == "killed" else signal.SIGSTOP)
        return now_s

    def again(self) -> None:
        if self._how == "stop" and self._finger is not None:
            self._tell("release")
            time.sleep(STANDS_S)
            at_s = time.monotonic()
            self._tell("stand")
            time.sleep(STANDS_S)
            self.servos.rest_after_s(at_s)
            return
        if self._how == "released" and self._finger is not None:
            return
        self._leave()
        self._finger = subprocess.Popen(
            [sys.executable, "-m", "tests.cli.stopping.finger", self.port],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._finger.stdout is not None
        if self._finger.stdout.readline() != "open\n":
            raise LostDriveError("the page's client does not open")

    def _tell(self, line: str) -> None:
        assert self._finger is not None
        assert self._finger.stdin is not None
        self._finger.stdin.write(line + "\n")
        self._finger.stdin.flush()

    def _leave(self) -> None:
        if self._finger is not None:
            self._finger.kill()
            self._finger.wait()
            for end in (self._finger.stdin, self._finger.stdout):
                if end is not None:
                    with suppress(BrokenPipeError):
                        end.close()


class BrowserDriven(Driven):
    """Driven with the page in a browser: its finger lifted, or its tab closed.

    Args:
        how: `lifted` or `left`.
    """

    def begin(self) -> None:
        self._stack = ExitStack()
        self.drive = local(self.folder, self.servos, "--page", "127.0.0.1:0", "--gamepad", "none")
        self._url = self.drive.wait_for(r"http://127\.0\.0\.1:\d+/")[0]
        self._page = self._stack.enter_context(browser((800, 900), self.folder))
        self._show()
        time.sleep(BROWSER_S)

    def end(self) -> None:
        super().end()
        with suppress(BrowserError):
            self._stack.close()

    def command(self) -> None:
        x, y, width = self._page.value(
            "(() => { const b = document.getElementById('walk').getBoundingClientRect();"
            " return [b.x + b.width / 2, b.y + b.height / 2, b.width]; })()"
        )
        forward, left, _ = self.shares()
        self._page.touch(x - 0.45 * left * width, y - 0.45 * forward * width)

    def cause(self) -> float:
        now_s = time.monotonic()
        if self._how == "lifted":
            self._page.lift()
        else:
            self._page.leave()
        return now_s

    def again(self) -> None:
        if self._how == "left":
            self._page.open()
            self._show()

    def _show(self) -> None:
        self._page.go(self._url)
        ready = "document.getElementById('walk')?.classList.contains('off') === false"
        wait_for(lambda: self._page.value(ready), PATIENCE_S, "the page does not connect")


class KeysDriven(Driven):
    """Driven with the keys of a terminal: the space bar, the key that stops, or a terminal that goes.

    Args:
        how: `space`; `stop`, the key x; `closed`, its own terminal, as that of a shell's window; `hangup`,
            SIGHUP; `killed` or `frozen`, the process with the terminal by SIGKILL or SIGSTOP.
    """

    _terminal: "OnTerminal | Emulated | None" = None

    def begin(self) -> None:
        arguments = ["--backend", RECORDED, "--gamepad", "none"]
        variables = {VARIABLE: str(self.servos.path)}
        if self._how in ("killed", "frozen"):
            self._terminal = Emulated(arguments, self.folder, variables)
        else:
            program = WITH_TERMINAL if self._how == "closed" else COMMAND
            self._terminal = OnTerminal(arguments, self.folder, program=program, variables=variables)
        self._terminal.wait("tripod · driving")

    def end(self) -> None:
        if self._terminal is not None:
            self._terminal.end()

    def alive(self) -> bool:
        return self._terminal is not None and self._terminal.process.poll() is None

    def command(self) -> None:
        if self._terminal is None:
            self.begin()
        assert self._terminal is not None
        self._terminal.type(self.chance.choice(HEADINGS))

    def cause(self) -> float:
        assert self._terminal is not None
        now_s = time.monotonic()
        if self._how in ("space", "stop"):
            self._terminal.type(" " if self._how == "space" else "x")
        elif isinstance(self._terminal, OnTerminal) and self._how == "closed":
            return self._terminal.close()
        else:
            self._terminal.process.send_signal(SIGNALS[self._how])
        return now_s

    def again(self) -> None:
        if self._how == "space":
            return
        assert self._terminal is not None
        if self._how == "stop":
            at_s = time.monotonic()
            self._terminal.type("1")
            time.sleep(STANDS_S)
            self.servos.rest_after_s(at_s)
            return
        if self._how == "frozen":
            self._terminal.process.send_signal(signal.SIGCONT)
            time.sleep(AWAKE_S)
            return
        code = self._terminal.code()
        assert code == 0, code
        self._terminal.end()
        self._terminal = None


#: A terminal's process, which tells its status when it is asked, and what it starts: `hexctl drive`, which
#: says who it is, and when it has ended.
EMULATOR = """
import os, pty, sys

def shown(terminal):
    data = os.read(terminal, 1024)
    os.write(terminal, b"\\x1b[0n" * data.count(b"\\x1b[5n"))
    return data

pty.spawn(sys.argv[1:], shown)
"""
TOLD = (
    "import atexit, os, pathlib\n"
    "pathlib.Path('begun').write_text(str(os.getpid()))\n"
    "atexit.register(pathlib.Path('ended').touch)\n"
    f"{COMMAND}"
)


class Emulated:
    """`hexctl drive` on a terminal that belongs to another process, which may be killed."""

    def __init__(self, arguments: list[str], folder: Path, variables: dict[str, str]) -> None:
        self._folder = folder
        for name in ("begun", "ended"):
            (folder / name).unlink(missing_ok=True)
        self._output = (folder / "terminal.out").open("wb")
        self.process = subprocess.Popen(
            [sys.executable, "-c", EMULATOR, sys.executable, "-c", TOLD, "drive", *arguments],
            cwd=folder,
            env={**os.environ, **variables},
            stdin=subprocess.PIPE,
            stdout=self._output,
            stderr=subprocess.STDOUT,
        )

    def wait(self, text: str) -> None:
        shown = self._folder / "terminal.out"
        wait_for(
            lambda: text in shown.read_text(encoding="utf-8", errors="replace"),
            PATIENCE_S,
            f"{text} is not shown",
        )

    def type(self, keys: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(keys.encode())
        self.process.stdin.flush()

    def code(self) -> int:
        wait_for(lambda: (self._folder / "ended").exists(), PATIENCE_S, "the drive does not end")
        return 0

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self._output.close()
        if self.process.stdin is not None:
            with suppress(BrokenPipeError):
                self.process.stdin.close()
        begun = self._folder / "begun"
        if begun.exists() and not (self._folder / "ended").exists():
            with suppress(ProcessLookupError):
                os.kill(int(begun.read_text()), signal.SIGKILL)


#: How long after a robot has stood up it walks for certain.
STOOD_S = 0.3


class LinkDriven(Driven):
    """Driven with a gamepad over a link.

    Args:
        how: `released`; `killed` or `stopped`, the drive by SIGKILL or SIGSTOP; `held`, the cable takes what
            is sent and passes nothing on, as a pulled plug does; `cut`, it closes the connections.
    """

    def begin(self) -> None:
        self._stack, self._drives = ExitStack(), ExitStack()
        # It does not sit down while it waits for the next drive.
        self._robot = self._stack.enter_context(served(self.folder, "--sit-after", "3600", name="served"))
        self.servos = type(self.servos)(self._robot.log_path)
        self._pad = Pad(self.folder / "pad", pipe=True)
        self._pad.plug_in()
        self._stack.callback(self._pad.plug_out)

    def end(self) -> None:
        self._drives.close()
        self._stack.close()

    def command(self) -> None:
        if self.drive is None:
            self._cable = self._drives.enter_context(Cable(self._robot.endpoint))
            link = ("--backend", "zenoh", "--connect", self._cable.endpoint)
            self.drive = Process(self.folder, self.servos.path, *link, "--gamepad", str(self._pad.path))
            self._drives.callback(self.drive.end)
        self._pad.press(*self.shares())

    def walk(self) -> None:
        if self.drive is None:
            began_s = time.monotonic()
            self.command()
            wait_for(
                lambda: self.servos.told_after(began_s) or not self.alive(), PATIENCE_S, "no targets come"
            )
            time.sleep(SITTING_S + STOOD_S)
        super().walk()

    def cause(self) -> float:
        assert self.drive is not None
        if self._how == "released":
            return self._pad.release()
        if self._how in ("killed", "stopped"):
            return self.drive.signal(signal.SIGKILL if self._how == "killed" else signal.SIGSTOP)
        return self._cable.cut("hold" if self._how == "held" else "close")

    def again(self) -> None:
        if self._how != "released":
            self._pad.release()
            self._drives.close()
            self.drive = None
