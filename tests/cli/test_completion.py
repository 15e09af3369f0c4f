"""The Tab key, asked as the shells ask it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hexctl.adapt.sessions.store import SessionStore
from hexctl.backends.registry import BACKENDS
from hexctl.cli import completion
from hexctl.robot.configs import config_names
from tests.adapt.walking import SPEC

pytestmark = pytest.mark.long

#: Calls hexctl as its console script does, and says on stderr what it has loaded.
HEXCTL = """
import atexit, sys
sys.argv[0] = "hexctl"
loaded = ("mujoco", "dm_control", "rerun", "scipy", "zenoh", "pymavlink", "matplotlib", "distributed", "cv2")
atexit.register(lambda: print([name for name in loaded if name in sys.modules], file=sys.stderr))
from hexctl.cli.entry import main
main()
"""

SHELLS = ("bash", "zsh", "fish")


def asked(shell: str, line: str, folder: Path) -> list[str]:
    """Words that a shell is offered for the last word of a line."""
    words = line.split(" ")
    variables = {
        "_HEXCTL_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    done = subprocess.run(
        [sys.executable, "-c", HEXCTL],
        cwd=folder,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip() == "[]", "a Tab must not wait for these to load"
    if shell == "zsh":
        return [word for line in done.stdout.splitlines() for word in line.split('"')[1:2]]
    return [line.split("\t")[0] for line in done.stdout.splitlines() if line]


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("hexctl run --robot ", config_names("robots")),
        ("hexctl run --world s", ["slippery", "slope"]),
        ("hexctl prior build --family ", ["randomised", "real", "transfer"]),
        ("hexctl run --gait ", ["auto", "best", "demo", "tripod", "wave", "ripple"]),
        ("hexctl run --failed-leg ", ["1", "2", "3", "4", "5", "6", "auto"]),
        ("hexctl run --failure 5:l", ["5:locked", "5:limp"]),
        ("hexctl serve --backend ", [name for name in BACKENDS if name != "zenoh"]),
        ("hexctl drive --gamepad n", ["none"]),
        ("hexctl d", ["drive", "demo", "diagnose", "doctor"]),
        ("hexctl doctor --", ["--json", "--help"]),
    ],
)
def test_values_are_offered(line: str, offered: list[str], tmp_path: Path) -> None:
    assert asked("bash", line, tmp_path) == offered


@pytest.mark.parametrize("shell", SHELLS)
def test_all_shells_are_answered(shell: str, tmp_path: Path) -> None:
    assert asked(shell, "hexctl run --robot ph", tmp_path) == ["phantomx", "phantomx-ax"]


@pytest.mark.parametrize("line", ["hexctl adapt --resume ", "hexctl view "])
def test_sessions_are_offered(line: str, tmp_path: Path) -> None:
    store = SessionStore(tmp_path / "runs")
    name = store.create(SPEC).name
    assert asked("bash", line, tmp_path) == [name]


def test_what_is_offered_is_that_of_the_folder_of_runs(tmp_path: Path) -> None:
    (tmp_path / "hexctl.toml").write_text('runs = "out"\nrobot = "pexod"\n')
    store = SessionStore(tmp_path / "out")
    name = store.create(SPEC).name
    assert asked("bash", "hexctl sessions show ", tmp_path) == [name]
    (tmp_path / "hexctl.toml").write_text("runs = [")
    assert asked("bash", "hexctl sessions show ", tmp_path) == []
    assert asked("bash", "hexctl run --robot p", tmp_path) == ["pexod", "phantomx", "phantomx-ax"]


def test_recordings_are_offered_to_view(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "walk.rrd").touch()
    assert asked("bash", "hexctl view ru", tmp_path) == ["runs/walk.rrd"]


@pytest.mark.parametrize("line", ["hexctl run --robot ./m", "hexctl view mine"])
def test_where_no_word_fits_the_shell_offers_files(line: str, tmp_path: Path) -> None:
    assert asked("bash", line, tmp_path) == []


def test_gamepads_are_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    pad = Path("/dev/input/event5")
    monkeypatch.setattr("hexctl.teleop.gamepad.find_gamepads", lambda: [pad])
    assert completion.gamepads("") == ["auto", "none", str(pad)]
    assert completion.gamepads("/dev/") == [str(pad)]


def test_nothing_is_made_and_nothing_complains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert completion.sessions("") == []
    assert not list(tmp_path.iterdir())
    (tmp_path / "runs" / "mine").mkdir(parents=True)
    (tmp_path / "runs" / "mine" / "session.jsonl").write_text("not a session")
    assert completion.sessions("") == completion.viewable("") == ["mine"]


BASH = """
set -e
hexctl() {{ {python} -m hexctl "$@"; }}
hexctl --install-completion
source "$HOME/.bash_completions/hexctl.sh"
COMP_WORDS=(hexctl run --gait t)
COMP_CWORD=3
_hexctl_completion {hexctl}
echo "offered: ${{COMPREPLY[*]}}"
"""


def test_bash_completes_once_it_is_installed(tmp_path: Path) -> None:
    bash, hexctl = shutil.which("bash"), Path(sys.executable).with_name("hexctl")
    if bash is None or not hexctl.is_file():
        pytest.skip("needs bash and the installed hexctl")
    done = subprocess.run(
        [bash, "--norc", "-c", BASH.format(python=sys.executable, hexctl=hexctl)],
        env=os.environ | {"HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "offered: tripod" in done.stdout, done.stderr
