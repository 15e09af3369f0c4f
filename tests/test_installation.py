"""Installing: the environment of make, the command that adds an extra, and systems other than Linux."""

import fcntl
import importlib.metadata
import json
import os
import queue
import shlex
import shutil
import subprocess
import sys
import threading
import tomllib
from pathlib import Path
from typing import Any

import pytest

from environment import Environment, SetUpError
from hexctl import installation
from hexctl.installation import install_command

ROOT = Path(__file__).parents[1]
HOME = Path("/home/ada")


class Installed:
    """Metadata of hexctl as an installer writes it."""

    def __init__(self, installer: str, origin: dict[str, Any] | None) -> None:
        self.requires = ['dm-control<2,>=1.0.50; python_version < "3.13" and extra == "sim"']
        self._texts = {
            "INSTALLER": f"{installer}\n",
            "direct_url.json": json.dumps(origin) if origin else None,
        }

    def read_text(self, name: str) -> str | None:
        return self._texts[name]


FOLDER_URL, EDITABLE = "file:///home/ada/my%20code/hexctl", {"dir_info": {"editable": True}}
GIT = {
    "url": "https://example.org/hexctl",
    "vcs_info": {"vcs": "git", "commit_id": "0", "requested_revision": "v0.1.0"},
}
WHEEL = {"url": "file:///opt/hexctl-0.1.0-py3-none-any.whl", "archive_info": {}}


@pytest.mark.parametrize(
    ("installer", "origin", "cwd", "command"),
    [
        ("pip", {"url": FOLDER_URL, **EDITABLE}, "/", "pip install -e ~/'my code/hexctl[i2c]'"),
        ("pip", {"url": FOLDER_URL, **EDITABLE}, "/home/ada/my code/hexctl", "pip install -e '.[i2c]'"),
        ("pip", {"url": FOLDER_URL, "dir_info": {}}, "/", "pip install ~/'my code/hexctl[i2c]'"),
        ("uv", {"url": FOLDER_URL, **EDITABLE}, "/", "uv pip install -e ~/'my code/hexctl[i2c]'"),
        ("pip", WHEEL, "/", "pip install '/opt/hexctl-0.1.0-py3-none-any.whl[i2c]'"),
        ("pip", GIT, "/", "pip install 'hexctl[i2c] @ git+https://example.org/hexctl@v0.1.0'"),
        ("pip", None, "/", "pip install 'hexctl[i2c]'"),
    ],
)
def test_an_extra_is_added_to_the_code_that_runs(
    monkeypatch: pytest.MonkeyPatch, installer: str, origin: dict[str, Any] | None, cwd: str, command: str
) -> None:
    monkeypatch.setattr(installation, "distribution", lambda _: Installed(installer, origin))
    monkeypatch.setattr(Path, "cwd", lambda: Path(cwd))
    monkeypatch.setattr(Path, "home", lambda: HOME)
    monkeypatch.setenv("VIRTUAL_ENV", sys.prefix)
    assert install_command("i2c") == command
    monkeypatch.delenv("VIRTUAL_ENV")  # `pip` may be that of another Python
    assert os.path.basename(sys.executable) in install_command("i2c")


@pytest.mark.parametrize(
    ("version", "present", "commands"),
    [
        ((3, 12), (), ["pip install 'hexctl[sim]'"]),
        ((3, 13), (), ["pip install 'hexctl[sim]'", "pip install --no-deps 'dm-control<2,>=1.0.50'"]),
        ((3, 13), ("mujoco", "dm_env"), ["pip install --no-deps 'dm-control<2,>=1.0.50'"]),
        ((3, 13), ("mujoco", "dm_env", "dm_control"), ["pip install 'hexctl[sim]'"]),
    ],
)
def test_dm_control_comes_without_labmaze_if_that_has_no_wheels(
    monkeypatch: pytest.MonkeyPatch, version: tuple[int, int], present: tuple[str, ...], commands: list[str]
) -> None:
    monkeypatch.setattr(installation, "distribution", lambda _: Installed("pip", None))
    monkeypatch.setattr(installation, "find_spec", lambda name: name in present or None)
    monkeypatch.setattr("sys.version_info", version)
    monkeypatch.setenv("VIRTUAL_ENV", sys.prefix)
    line = install_command("sim")
    assert shlex.split(line, comments=True) == shlex.split(" && ".join(commands))
    assert ("labmaze" in line) == ("--no-deps" in line), "the reason is a comment of the shell"


def test_extras_with_the_simulation_are_known() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]

    def simulates(extra: str) -> bool:
        own = [
            line.removeprefix("hexctl[").rstrip("]") for line in extras[extra] if line.startswith("hexctl[")
        ]
        return extra == "sim" or any(simulates(other) for names in own for other in names.split(","))

    assert set(filter(simulates, extras)) == set(installation.SIMULATING_EXTRAS)


def test_the_extra_has_all_that_dm_control_needs_but_labmaze() -> None:
    """An installation without dependencies misses nothing else."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    sim = project["project"]["optional-dependencies"]["sim"]
    needed = {_name(line) for line in importlib.metadata.requires("dm-control") or () if "extra" not in line}
    listed = {_name(line) for line in sim}
    pending = ["mujoco", "pymavlink", *(_name(line) for line in project["project"]["dependencies"])]
    brought = {_name(need) for name in pending for need in importlib.metadata.requires(name) or ()}
    assert needed - listed - brought - set(pending) == {"labmaze"}
    assert project["tool"]["uv"]["override-dependencies"][0] in sim[0]


def _name(requirement: str) -> str:
    text = requirement.lower().replace("_", "-")
    return text[: next((at for at, letter in enumerate(text) if letter in " ;<>=!~["), len(text))]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with what an installation depends on."""
    folder = tmp_path / "mein prüfstand"
    folder.mkdir()
    for name in ("pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, folder)
    return folder


def finished(checkout: Path, *, editable: bool = True) -> Environment:
    """An environment as a set-up left it, with the Python of the tests."""
    made = Environment(checkout, Path(".venv"))
    info = made.venv / "lib" / "python3" / "site-packages" / "hexctl-0.1.0.dist-info"
    info.mkdir(parents=True)
    origin = {"url": checkout.as_uri(), "dir_info": {"editable": True} if editable else {}}
    (info / "direct_url.json").write_text(json.dumps(origin))
    (made.venv / "bin").mkdir()
    made.python.symlink_to(sys.executable)
    (made.venv / "pyvenv.cfg").write_text("version = {}.{}.0\n".format(*sys.version_info))
    (made.venv / "hexctl.json").write_text(json.dumps(made._described(["all", "dev"])))
    return Environment(checkout, Path(".venv"))


@pytest.fixture
def pip_calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    calls: list[tuple[str, ...]] = []
    monkeypatch.setattr(Environment, "_pip", lambda _, *arguments: calls.append(arguments))
    monkeypatch.setattr(Environment, "_repair_pip", lambda _: True)
    return calls


class TestEnvironment:
    def test_what_is_set_up_is_kept(self, checkout: Path, pip_calls: list[tuple[str, ...]]) -> None:
        made = finished(checkout)
        made.set_up("all", "dev")
        made.set_up("dev")
        made.set_up("demo")  # `all` has it
        assert not pip_calls

    def test_a_copy_of_the_code_is_replaced(self, checkout: Path, pip_calls: list[tuple[str, ...]]) -> None:
        finished(checkout, editable=False).set_up("dev")
        assert pip_calls[0] == ("-e", ".[all,dev]")

    def test_a_changed_project_is_installed_again(
        self, checkout: Path, pip_calls: list[tuple[str, ...]]
    ) -> None:
        made = finished(checkout)
        with (checkout / "pyproject.toml").open("a") as file:
            file.write("# changed\n")
        made.set_up("dev")
        assert len(pip_calls) >= 1
        made.set_up("dev")
        assert len(pip_calls) == 2

    def test_a_moved_checkout_is_set_up_again(self, checkout: Path, pip_calls: list[tuple[str, ...]]) -> None:
        finished(checkout)
        moved = checkout.rename(checkout.with_name("moved"))
        (kept := moved / ".venv" / "old").touch()
        made = Environment(moved, Path(".venv"))
        made.set_up("dev")
        assert pip_calls
        assert not kept.exists()

    def test_an_installation_that_was_interrupted_begins_again(
        self, checkout: Path, pip_calls: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupt(environment: Environment, *_: object) -> None:
            environment._follow(["Installing collected packages: a, b"])
            raise KeyboardInterrupt

        made = finished(checkout, editable=False)
        with monkeypatch.context() as patched:
            patched.setattr(Environment, "_pip", interrupt)
            with pytest.raises(KeyboardInterrupt):
                made.set_up("dev")
        (half := made.venv / "half").touch()
        made.set_up("dev")
        assert pip_calls
        assert not half.exists()

    def test_a_pip_that_fails_before_it_changes_anything_leaves_the_environment(
        self, checkout: Path, pip_calls: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fail(environment: Environment, *_: object) -> None:
            environment._follow(["Collecting a"])
            raise SetUpError("no network")

        made = finished(checkout)
        (kept := made.venv / "kept").touch()
        with monkeypatch.context() as patched:
            patched.setattr(Environment, "_pip", fail)
            with pytest.raises(SetUpError):
                made.set_up("fuzz")
        made.set_up("dev")
        assert kept.exists()
        assert not pip_calls

    def test_another_python_replaces_the_environment_only_if_it_is_named(self, checkout: Path) -> None:
        (finished(checkout).venv / "pyvenv.cfg").write_text("version = 3.99.0\n")
        assert Environment(checkout, Path(".venv")).version == (3, 99)
        named = Environment(checkout, Path(".venv"), explicit_python=True)
        assert named.version == sys.version_info[:2]

    def test_an_environment_of_a_person_is_never_emptied(
        self, checkout: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(Environment, "_repair_pip", lambda _: False)
        (venv := checkout / "mine").mkdir()
        (venv / "pyvenv.cfg").write_text("version = 3.11.0\n")
        with pytest.raises(SetUpError, match="VENV="):
            Environment(checkout, Path("mine")).set_up("demo")
        assert (venv / "pyvenv.cfg").exists()

    def test_a_second_set_up_waits(
        self, checkout: Path, pip_calls: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        said: queue.Queue[str] = queue.Queue()
        monkeypatch.setattr("environment.say", said.put)
        made = finished(checkout, editable=False)
        holder = os.open(checkout, os.O_RDONLY)
        fcntl.flock(holder, fcntl.LOCK_EX)
        second = threading.Thread(target=made.set_up, args=("dev",), daemon=True)
        second.start()
        assert "waiting" in said.get(timeout=30)
        assert not pip_calls
        os.close(holder)
        second.join(30)
        assert pip_calls

    def test_a_folder_with_other_files_is_left_alone(self, checkout: Path) -> None:
        (kept := checkout / "letters" / "to ada").parent.mkdir()
        kept.touch()
        with pytest.raises(SetUpError, match="VENV="):
            Environment(checkout, Path("letters")).set_up("demo")
        assert kept.exists()

    def test_a_folder_that_cannot_be_written_is_named(self, checkout: Path) -> None:
        with pytest.raises(SetUpError, match="VENV="):
            Environment(checkout, Path("pyproject.toml") / "venv").set_up("demo")

    @pytest.mark.parametrize(("python", "code"), [(sys.executable, 0), ("false", 2), ("/no/python3.9", 2)])
    def test_an_unsupported_python_is_refused_by_make(self, python: str, code: int) -> None:
        command = ["make", "--no-print-directory", "supported", f"PYTHON={python}"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stderr
        assert ("PYTHON=" in done.stderr) == (code != 0)

    @pytest.mark.slow
    def test_without_network_the_next_step_is_named(
        self, checkout: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for name, value in {
            "PIP_CONFIG_FILE": os.devnull,
            "PIP_INDEX_URL": "http://127.0.0.1:9/",
            "PIP_FIND_LINKS": "",
            "PIP_RETRIES": "1",
        }.items():
            monkeypatch.setenv(name, value)
        made = Environment(checkout, Path(".venv"))
        with pytest.raises(SetUpError, match="network"):
            made.set_up("demo")
        assert (made.venv / "hexctl-begun").exists()
        assert not (made.venv / "hexctl.json").exists()


#: Names that macOS lacks, as a module that Python imports first.
LIKE_MACOS = """
import errno, os, select, signal, socket, time
for module, names in {
    os: "sched_getaffinity sched_setaffinity sched_getparam sched_setparam sched_getscheduler sched_param "
    "sched_setscheduler SCHED_RESET_ON_FORK posix_fallocate posix_fadvise fdatasync pipe2 eventfd getxattr",
    select: "epoll", signal: "sigtimedwait sigwaitinfo SIGRTMIN SIGPWR", time: "CLOCK_BOOTTIME",
    socket: "SO_PEERCRED SO_BINDTODEVICE SOCK_CLOEXEC SOCK_NONBLOCK", errno: "EREMOTEIO EBADFD",
}.items():
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [("run", "--failure", "5:limp@1", "--duration", "3", "--json"), ("doctor",), ("check", "ant")],
    ids=lambda words: words[0],
)
def test_the_simulation_needs_no_name_that_only_linux_has(tmp_path: Path, command: tuple[str, ...]) -> None:
    (tmp_path / "sitecustomize.py").write_text(LIKE_MACOS)
    done = subprocess.run(
        [sys.executable, "-m", "hexctl", *command],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs").exists() == (command[0] == "run"), "the walk is recorded"
