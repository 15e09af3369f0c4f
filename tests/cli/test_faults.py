"""What `hexctl run` says and returns when robot, link or disk fail: exit 3, one line, nothing lost."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hexctl.cli.main import exit_code
from hexctl.record import recording
from hexctl.record.columns import BlockWriter
from hexctl.record.files import ROOM_BYTES
from tests.cli.kits import Kit

KITS = "tests.cli.kits"


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Kit, "made", [])


def _run(kit: str, *more: str) -> int:
    return exit_code(["run", "--backend", f"{KITS}:{kit}", "--duration", "3", *more])


def _one_line(captured: str) -> str:
    (line,) = captured.splitlines()
    return line


def _strict(text: str) -> dict[str, Any]:
    """Return the one JSON object of a text, which knows no NaN."""
    outcome: dict[str, Any] = json.loads(_one_line(text), parse_constant=lambda name: pytest.fail(name))
    return outcome


@pytest.mark.parametrize(("kit", "reason"), [("Sick", "fault"), ("Lost", "pose lost")])
def test_a_fault_of_the_robot_is_a_result_that_says_why(
    kit: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(kit, "--no-record") == 3
    printed = capsys.readouterr()
    assert f"status     aborted ({reason})" in printed.out
    assert printed.err == ""
    assert _run(kit, "--no-record", "--json") == 3
    outcome = _strict(capsys.readouterr().out)
    assert (outcome["status"], outcome["stopped"]) == ("aborted", reason)
    assert 0 < outcome["duration_s"] < 3


@pytest.mark.parametrize("kit", ["PipeBreaks", "PortBreaks"])
@pytest.mark.parametrize("more", [[], ["--no-record"], ["--json"]], ids=["recorded", "not recorded", "json"])
def test_a_link_that_breaks_in_the_walk_is_one_line(
    kit: str, more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(kit, *more) == 3
    printed = capsys.readouterr()
    assert "status" not in printed.out, "there is no result"
    assert "the link to the robot failed" in _one_line(printed.err)
    assert [made.closed for made in Kit.made] == [1]
    if "--no-record" not in more:
        (path,) = (tmp_path / "runs").iterdir()
        assert path.stat().st_size > 10_000, "what was walked is kept"


@pytest.mark.parametrize(("kit", "word"), [("NoPipe", "Broken pipe"), ("NoPort", "/dev/ttyUSB7")])
def test_a_robot_that_cannot_be_reached_is_one_line_and_leaves_nothing(
    kit: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(kit) == 3
    printed = capsys.readouterr()
    assert printed.out == ""
    line = _one_line(printed.err)
    assert "the robot cannot be reached" in line
    assert word in line
    assert list(tmp_path.iterdir()) == [], "no recording of a walk that never was"
    assert [made.closed for made in Kit.made] == [1]


def test_a_kit_in_good_health_walks(capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("Kit", "--no-record", "--gait", "tripod", "--turn", "5", "--json") == 0
    assert _strict(capsys.readouterr().out)["stopped"] is None
    assert [made.closed for made in Kit.made] == [1]


def test_a_file_where_the_recordings_go_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs").write_text("mine")
    assert _run("Kit") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    line = _one_line(printed.err)
    for word in ("runs/", "a folder", "--record FILE"):
        assert word in line
    assert (tmp_path / "runs").read_text() == "mine"
    assert all(not made.sent for made in Kit.made), "nothing moved"


@pytest.mark.parametrize("block_ticks", [1, 2000], ids=["in the walk", "at its end"])
def test_a_recording_that_fails_costs_neither_the_walk_nor_its_result(
    block_ticks: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: object) -> Iterator[None]:
        yield
        raise RuntimeError("no space\nleft")

    monkeypatch.setattr(recording, "BLOCK_TICKS", block_ticks)
    monkeypatch.setattr(BlockWriter, "steps", fail)
    assert _run("Kit", "--turn", "5", "--json") == 3
    printed = capsys.readouterr()
    outcome = _strict(printed.out)
    assert (outcome["status"], outcome["duration_s"]) == ("ok", pytest.approx(3))
    assert "the walk is done, its recording is not whole: no space left" in _one_line(printed.err)


FULL_DISK = """
import resource, signal, sys
from hexctl.cli.main import exit_code
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
sys.exit(exit_code(["run", "--duration", "20", "--json"]))
"""


def test_a_disk_without_room_is_said_before_the_walk(tmp_path: Path) -> None:
    done = _run_on_a_small_disk(tmp_path, ROOM_BYTES - 1)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "cannot be written (File too large)" in _one_line(done.stderr)
    assert not list(tmp_path.glob("runs/*"))


def _run_on_a_small_disk(folder: Path, size_bytes: int) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(size_bytes)],
        cwd=folder,
        env={**os.environ, "RUST_LOG": "off"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_full_disk_costs_neither_the_walk_nor_its_result(tmp_path: Path) -> None:
    done = _run_on_a_small_disk(tmp_path, ROOM_BYTES)
    assert done.returncode == 3, done.stderr
    assert _strict(done.stdout)["status"] == "ok"
    line = _one_line(done.stderr)
    assert "its recording is not whole" in line
    assert ".rrd" in line


CURRENT_FOLDER_KIT = """
from hexctl import MockServos, WallClock


class KitServos(MockServos):
    def __init__(self, robot):
        self.now_s = 0.0
        super().__init__(robot, clock=WallClock(monotonic_s=lambda: self.now_s, sleep=self.go_on))

    def go_on(self, duration_s):
        self.now_s += max(duration_s, 1e-9)
"""


@pytest.mark.parametrize(
    "program",
    [[str(Path(sys.executable).with_name("hexctl"))], [sys.executable, "-m", "hexctl"]],
    ids=["installed", "module"],
)
def test_servos_in_the_current_folder_are_found(program: list[str], tmp_path: Path) -> None:
    if not Path(program[0]).exists():
        pytest.skip("hexctl is not installed beside this Python")
    (tmp_path / "kit_of_this_folder.py").write_text(CURRENT_FOLDER_KIT)
    arguments = [
        "run",
        "--backend",
        "kit_of_this_folder:KitServos",
        "--no-record",
        "--duration",
        "1",
        "--json",
    ]
    done = subprocess.run(
        [*program, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert _strict(done.stdout)["backend"] == "kit_of_this_folder:KitServos"
