"""The Tab key, asked as the shells ask it."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hexctl.adapt.sessions.store import SessionStore
from hexctl.backends.registry import BACKENDS
from hexctl.cli import completion
from hexctl.cli.main import exit_code
from hexctl.robot.configs import config_names
from tests.adapt.walking import SPEC
from tests.cli.terminals import run_program

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

Asked = Callable[[str], list[str]]


def variables(shell: str, line: str) -> dict[str, str]:
    """What a shell sets to ask for the last word of a line."""
    return {
        "_HEXCTL_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Asked:
    """Words that bash is offered for the last word of a line."""

    def answered(line: str) -> list[str]:
        for name, text in variables("bash", line).items():
            monkeypatch.setenv(name, text)
        with pytest.raises(SystemExit, match="0"):
            exit_code([])
        return [word for word in capsys.readouterr().out.splitlines() if word]

    return answered


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("hexctl run --robot ", config_names("robots")),
        ("hexctl run --world s", ["slippery", "slope", "stand", "steps"]),
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
def test_values_are_offered(line: str, offered: list[str], asked: Asked) -> None:
    assert asked(line) == offered


@pytest.mark.slow
@pytest.mark.parametrize("shell", SHELLS)
def test_all_shells_are_answered(shell: str) -> None:
    done = run_program(HEXCTL, **variables(shell, "hexctl run --robot ph"))
    assert done.stderr.strip() == "[]", "a Tab must not wait for these to load"
    words = re.findall(r"phantomx\S*", done.stdout.replace('"', " "))
    assert sorted({*words}) == ["phantomx", "phantomx-ax"]


def test_sessions_and_recordings_of_the_folder_of_runs_are_offered(asked: Asked) -> None:
    Path("hexctl.toml").write_text('runs = "out"\nrobot = "pexod"\n')
    name = SessionStore(Path("out")).create(SPEC).name
    for command in ("adapt --resume", "sessions show", "view"):
        assert asked(f"hexctl {command} ") == [name]
    Path("out", "walk.rrd").touch()
    assert asked("hexctl view ou") == ["out/walk.rrd"]
    Path("hexctl.toml").write_text("runs = [")
    assert asked("hexctl sessions show ") == []
    assert asked("hexctl run --robot p") == ["pexod", "phantomx", "phantomx-ax"]


def test_gamepads_are_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    pad = Path("/dev/input/event5")
    monkeypatch.setattr("hexctl.teleop.gamepad.find_gamepads", lambda: [pad])
    assert completion.gamepads("") == ["auto", "none", str(pad)]
    assert completion.gamepads("/dev/") == [str(pad)]


def test_nothing_is_made_and_nothing_complains(tmp_path: Path) -> None:
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


@pytest.mark.slow
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
