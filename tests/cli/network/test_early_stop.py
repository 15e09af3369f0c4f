"""The stop that is sent before the command line is loaded goes where the command line would send it."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest

from hexctl.cli.main import exit_code
from hexctl.cli.network import early_stop
from hexctl.cli.network.early_stop import begin_stop, place_of, take_stop
from hexctl.errors import RobotFaultError
from hexctl.wire.links import Link, load_link
from tests.server.processes import ROOT, free_port, served, wait_until
from tests.server.test_link_faults import stopped

ANT, BEE = "tls/ant.local:7448", "tcp/127.0.0.1:7449"

#: Arguments that are understood early.
UNDERSTOOD: tuple[list[str], ...] = (
    [],
    ["--json"],
    ["--connect", BEE],
    [f"--connect={ANT}", "--insecure"],
    ["--connect", ANT, "--keys", "my keys", "--json"],
    ["--keys", "other"],
)

#: Content of `hexctl.toml`, and variables.
SETTINGS: tuple[tuple[str, dict[str, str]], ...] = (
    ("", {}),
    (f'connect = "{ANT}"\nkeys = "keys"\n', {}),
    (f'connect = "{BEE}"\nkeys = "keys"\n[estop]\nconnect = "{ANT}"\njson = true\n', {}),
    (f'[commands.estop]\nconnect = "{ANT}"\nkeys = "~/keys"\n', {"HEXCTL_CONNECT": BEE}),
    ('keys = "keys"\nlink = "lab.yaml"\n', {"HEXCTL_ESTOP_KEYS": "from here"}),
    ('[estop]\nlink = "lab.yaml"\nkeys = "keys"\n', {}),
)


class FoundPlace:
    """In place of a stop: it notes where it would have been sent."""

    link: Link | None = None

    def __init__(self, *, again: bool, connect: str | None, link: str | None, **given: Any) -> None:
        FoundPlace.link = load_link(link, endpoint=connect, **given)
        raise RobotFaultError("not sent")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing was begun."""


@pytest.mark.parametrize("arguments", UNDERSTOOD)
@pytest.mark.parametrize(("file", "variables"), SETTINGS)
def test_it_goes_where_the_command_line_would_send_it(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: list[str],
    file: str,
    variables: dict[str, str],
) -> None:
    (tmp_path / "hexctl.toml").write_text(file, encoding="utf-8")
    (tmp_path / "lab.yaml").write_text(f"endpoint: {ANT}\n", encoding="utf-8")
    for name, text in variables.items():
        monkeypatch.setenv(name, text)
    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", FoundPlace)
    with contextlib.chdir(tmp_path):
        place = place_of(arguments)
        assert exit_code(["estop", *arguments]) == 3
    if place is None:
        assert "link" in file
    else:
        assert FoundPlace.link == load_link(endpoint=place.pop("connect"), **place)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--clear"],
        ["--ready", "--connect", BEE],
        ["--link", "lab"],
        ["--connect"],
        ["--connect", "--json"],
        ["--connect", BEE, "--connect", ANT],
        ["--conn", BEE],
        ["somewhere"],
        ["--connect="],
        ["connect", BEE],
        ["--json=yes"],
    ],
)
def test_arguments_in_doubt_are_left_to_the_command_line(arguments: list[str]) -> None:
    assert place_of(arguments) is None


def test_the_tab_key_and_wrong_settings_stop_nothing_early(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with contextlib.chdir(tmp_path):
        assert place_of([]) is not None
        monkeypatch.setenv("_HEXCTL_COMPLETE", "complete_bash")
        assert place_of([]) is None
        monkeypatch.delenv("_HEXCTL_COMPLETE")
        Path("hexctl.toml").write_text("connect = 7\n", encoding="utf-8")
        assert place_of([]) is None


def test_a_stop_is_taken_once_and_by_its_own_place_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_stop, "CONFIRM_S", 0.0)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    place = {"connect": endpoint, "credentials": None, "insecure": False, "link": None}
    begin_stop(["--connect", endpoint])
    stop = take_stop(place)
    assert stop is not None
    stop.end_datagrams()
    assert take_stop(place) is None
    begin_stop(["--connect", endpoint])
    assert take_stop({**place, "connect": f"tcp/127.0.0.1:{free_port()}"}) is None
    begin_stop(["--connect", "nowhere"])
    assert take_stop(place) is None, "the command says what is wrong"


#: A command whose command line is never loaded.
STUCK = """
import sys, time
class Stuck:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            time.sleep(600.0)
sys.meta_path.insert(0, Stuck())
from hexctl.cli.entry import main
main()
"""


@contextmanager
def stuck(*arguments: str) -> Iterator[None]:
    """Run the command as far as the loading of its command line."""
    words = [sys.executable, "-c", STUCK, *arguments]
    process = subprocess.Popen(words, cwd=ROOT, env={**os.environ, "HEXCTL_SETTINGS": "none"})
    try:
        yield
    finally:
        process.kill()
        process.wait()


@pytest.mark.realtime
def test_the_robot_is_stopped_before_the_command_line_is_loaded(tmp_path: Path) -> None:
    with served(tmp_path) as robot, stuck("estop", "--connect", robot.endpoint):
        wait_until(lambda: stopped(robot) == "estop", "the stop")
