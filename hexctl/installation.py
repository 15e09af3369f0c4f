"""How hexctl is installed, and the command that adds an extra and keeps its code where it is."""

import json
import os
import shlex
import sys
from collections.abc import Mapping
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

#: Extras with dm_control.
SIMULATING_EXTRAS = ("sim", "study", "demo", "learn", "train", "all", "dev")

#: The first Python without wheels of labmaze, which dm_control asks for and hexctl does not use.
WITHOUT_LABMAZE = (3, 13)


def install_command(extra: str) -> str:
    """Shell command that installs an extra: `pip install -e '.[i2c]'`.

    An editable installation stays editable. From Python 3.13 on, dm_control is installed without labmaze, and
    a comment of the shell says why.
    """
    try:
        installed: Distribution | None = distribution("hexctl")
    except PackageNotFoundError:
        installed = None
    installer = _installer(installed)
    commands = [f"{installer} {_target(installed, extra)}"]
    lacks_dm_control = extra in SIMULATING_EXTRAS and find_spec("dm_control") is None
    if lacks_dm_control and sys.version_info >= WITHOUT_LABMAZE:
        commands.append(f"{installer} --no-deps {shlex.quote(_dm_control(installed))}")
        if extra == "sim" and find_spec("mujoco") and find_spec("dm_env"):
            commands = commands[1:]
        commands[-1] += f"  # the extra leaves it out: its labmaze has no wheel for Python {_version()}"
    return " && ".join(commands)


def _version() -> str:
    return ".".join(map(str, sys.version_info[:2]))


def _installer(installed: Distribution | None) -> str:
    """The pip of this Python, by its path unless the environment is active."""
    uv = installed is not None and (installed.read_text("INSTALLER") or "").strip() == "uv"
    active = os.environ.get("VIRTUAL_ENV") == sys.prefix
    if uv:
        return "uv pip install" if active else f"uv pip install --python {_shown(Path(sys.executable))}"
    return "pip install" if active else f"{_shown(Path(sys.executable))} -m pip install"


def _target(installed: Distribution | None, extra: str) -> str:
    """Requirement of hexctl with an extra, from where it was installed."""
    origin: Mapping[str, Any] = json.loads((installed and installed.read_text("direct_url.json")) or "{}")
    url, folder = origin.get("url", ""), origin.get("dir_info")
    if installed is None:  # imported from a folder
        url, folder = Path(__file__).parents[1].as_uri(), {"editable": True}
    if url.startswith("file:"):
        path = Path(url2pathname(urlsplit(url).path))
        editable = "-e " if folder and folder.get("editable") else ""
        return f"{editable}{_shown(path, f'[{extra}]')}"
    if url:
        return shlex.quote(f"hexctl[{extra}] @ {_in_vcs(url, origin.get('vcs_info'))}")
    return shlex.quote(f"hexctl[{extra}]")


def _in_vcs(url: str, vcs: Mapping[str, str] | None) -> str:
    if vcs is None:
        return url
    revision = vcs.get("requested_revision")
    return f"{vcs['vcs']}+{url}" + (f"@{revision}" if revision else "")


def _dm_control(installed: Distribution | None) -> str:
    for line in (installed and installed.requires) or ():
        if line.startswith("dm-control"):
            return line.partition(";")[0].strip()
    return "dm-control"


def _shown(path: Path, suffix: str = "") -> str:
    """A path for a shell: relative inside the current folder, and without the name of the person's home."""
    if path == Path.cwd():
        return shlex.quote(f".{suffix}")
    for folder, prefix in ((Path.cwd(), "./"), (Path.home(), "~/")):
        if len(folder.parts) > 1 and path.is_relative_to(folder):
            return prefix + shlex.quote(f"{path.relative_to(folder)}{suffix}")
    return shlex.quote(f"{path}{suffix}")
