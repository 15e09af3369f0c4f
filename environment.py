"""Sets up the virtual environment of make: `python environment.py .venv demo` installs that extra, editable.

An environment that is right is kept. One that is half made or was moved is made again, and a copy of the code
is replaced by the checkout. It needs nothing but a supported Python, which make looks for.
"""

import argparse
import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

#: The next step if a folder is of no use.
NAME_VENV = "name another folder by VENV=/path/to/venv"
#: Extras that make asks for and that `all` contains.
IN_ALL = {"demo"}
#: Words in pip's errors if it reaches no package index.
UNREACHABLE = re.compile(r"NewConnectionError|NameResolutionError|ConnectTimeoutError|ProxyError")


class SetUpError(Exception):
    """A cause and the next step."""


class Environment:
    """A virtual environment of a checkout; an explicit Python replaces that of an existing one."""

    def __init__(self, checkout: Path, venv: Path, *, explicit_python: bool = False) -> None:
        self.checkout, self.venv = checkout.resolve(), checkout.resolve() / venv
        self.python = self.venv / "bin" / "python"
        # What was installed, written last; and the mark of an installation that changes the environment.
        self._stamp, self._begun = self.venv / "hexctl.json", self.venv / "hexctl-begun"
        existing = () if explicit_python else self._existing_version()
        self.version: tuple[int, ...] = existing or sys.version_info[:2]

    def _existing_version(self) -> tuple[int, ...]:
        try:
            text = (self.venv / "pyvenv.cfg").read_text()
        except OSError:
            return ()
        found = re.search(r"^version\w*\s*=\s*(\d+)\.(\d+)", text, re.MULTILINE)
        return (int(found[1]), int(found[2])) if found else ()

    def set_up(self, *extras: str) -> None:
        """Install extras that are missing; another process that sets up this checkout is waited for.

        Raises SetUpError for a folder that cannot be written, without network, and for errors of pip.
        """
        descriptor = os.open(self.checkout, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another make sets up this folder; waiting for it")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        try:
            stamp = self._read_stamp()
            present = {*stamp.get("extras", ())}
            wanted = sorted(present | {*extras} - (IN_ALL if "all" in present else set()))
            if stamp != self._described(wanted) or not self.python.exists() or not self._runs_checkout():
                self._begin(moved=stamp.get("checkout", str(self.checkout)) != str(self.checkout))
                self._install(wanted)
                self._stamp.write_text(json.dumps(self._described(wanted)))
                self._begun.unlink(missing_ok=True)
        finally:
            os.close(descriptor)

    def _read_stamp(self) -> dict[str, Any]:
        try:
            return dict(json.loads(self._stamp.read_text()))
        except (OSError, ValueError):
            return {}

    def _described(self, extras: list[str]) -> dict[str, Any]:
        files = (self.checkout / name for name in ("pyproject.toml", "constraints.txt"))
        digest = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
        python = list(self.version)
        return {"extras": extras, "checkout": str(self.checkout), "files": digest, "python": python}

    def _runs_checkout(self) -> bool:
        """False for a copy of the code, which `pip install .` makes."""
        for path in self.venv.glob("lib/python*/site-packages/hexctl-*.dist-info/direct_url.json"):
            origin = json.loads(path.read_text())
            return bool(origin["url"] == self.checkout.as_uri() and origin["dir_info"].get("editable"))
        return False

    def _begin(self, *, moved: bool) -> None:
        """Keep an environment that pip can change, or make one; a person's own is never emptied."""
        half_made, filled = self._begun.exists(), self.venv.is_dir() and any(self.venv.iterdir())
        if not moved and not half_made and self._repair_pip():
            say(f"updating {self.venv.name}: its packages differ, or it runs a copy of the code")
            return
        if filled and not (half_made or self._stamp.exists()):
            raise SetUpError(f"{self.venv}: holds other files, and no environment with pip; {NAME_VENV}")
        try:
            self.venv.mkdir(parents=True, exist_ok=True)
            self._make()
        except OSError as error:
            raise SetUpError(f"{self.venv}: cannot be written ({error.strerror}); {NAME_VENV}") from error

    def _repair_pip(self) -> bool:
        """Whether the environment has the wanted Python, and a pip, which uv leaves out."""
        code = f"import sys; sys.exit(sys.version_info[:2] != {self.version})"
        try:
            return all(
                subprocess.run([self.python, *arguments], capture_output=True).returncode == 0
                for arguments in (("-c", code), ("-m", "ensurepip"), ("-m", "pip", "--version"))
            )
        except OSError:
            return False

    def _make(self) -> None:
        self.version = sys.version_info[:2]
        version = ".".join(map(str, self.version))
        say(f"setting up {self.venv.name} with Python {version}, which takes a minute or two")
        self._mark()
        for path in self.venv.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif path != self._begun:
                path.unlink()
        made = subprocess.run([sys.executable, "-m", "venv", self.venv], capture_output=True, text=True)
        if made.returncode:
            sys.stderr.write(made.stdout + made.stderr)
            raise SetUpError("python -m venv failed; on Debian and Ubuntu: sudo apt-get install python3-venv")

    def _mark(self) -> None:
        self._begun.touch()
        self._stamp.unlink(missing_ok=True)

    def _install(self, extras: list[str]) -> None:
        self._pip("-e", f".[{','.join(extras)}]")
        # From Python 3.13 on, the extra leaves out dm_control, because labmaze has no wheels there.
        project = tomllib.loads((self.checkout / "pyproject.toml").read_text())
        self._pip("--no-deps", project["tool"]["uv"]["override-dependencies"][0])

    def _pip(self, *arguments: str) -> None:
        """Run pip with one line of progress on a terminal; its errors are shown if it fails."""
        # Modules are compiled at their first import: most of them are never imported.
        options = ["--disable-pip-version-check", "--no-compile", "--only-binary=:all:"]
        options += ["-c", "constraints.txt"]
        command = [str(self.python), "-m", "pip", "install", *options, *arguments]
        log = self.venv / "hexctl-pip.txt"
        with (
            log.open("w") as errors,
            subprocess.Popen(
                command, cwd=self.checkout, stdout=subprocess.PIPE, stderr=errors, text=True
            ) as process,
        ):
            self._follow(process.stdout or ())
        if process.returncode:
            said = log.read_text()
            if UNREACHABLE.search(said):
                raise SetUpError("no answer from the package index; connect to the network, then repeat")
            sys.stderr.write(said)
            raise SetUpError("pip failed, see above; remove the cause, then repeat")

    def _follow(self, lines: Iterable[str]) -> None:
        """Show what pip does as one line on a terminal; from "Installing" on, the environment changes."""
        shown, found = sys.stderr.isatty(), 0
        for line in lines:
            text = ""
            if line.startswith("Collecting"):
                found += 1
                text = f"found {found} packages"
            elif line.startswith("Installing"):
                self._mark()
                count = line.count(", ") + 1
                text = f"installing {count} package{'s' if count > 1 else ''}"
            if shown and text:
                sys.stderr.write(f"\r{text:50}")
                sys.stderr.flush()
        if shown:
            sys.stderr.write(f"\r{'':50}\r")


def say(text: str) -> None:
    """Print a line for the person who typed make."""
    sys.stderr.write(f"{text}\n")


def main() -> None:
    """Set up the environment of this checkout."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("venv", type=Path, help="folder of the environment")
    parser.add_argument("extras", nargs="+", help="extras of pyproject.toml")
    parser.add_argument("--explicit-python", action="store_true", help="replace another one")
    given = parser.parse_args()
    checkout = Path(__file__).parent
    Environment(checkout, given.venv, explicit_python=given.explicit_python).set_up(*given.extras)


if __name__ == "__main__":
    try:
        main()
    except SetUpError as error:
        sys.exit(f"set-up: {error}")
    except KeyboardInterrupt:
        sys.exit("\nset-up: it was interrupted; the next make begins it again")
