"""The program: what it loads, missing extras, hostile paths and files, and its exit codes."""

import errno
import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import hexctl
from hexctl.cli.console import flag_of, in_flags
from hexctl.cli.entry import MAY_HANG
from hexctl.errors import InputError, argument
from tests.cli.conftest import Call
from tests.cli.terminals import run_program

PACKAGE = Path(hexctl.__file__).parent

HEAVY = (
    *("mujoco", "dm_control", "rerun", "numpy", "pydantic", "yaml", "scipy", "pymavlink", "serial"),
    *("hexctl.settings", "tomllib"),
)


def test_help_and_the_package_load_nothing_heavy() -> None:
    done = run_program(
        "import sys, hexctl\nfrom hexctl.cli.main import exit_code\nassert exit_code(['--help']) == 0\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    assert "run" in done.stdout
    assert (done.returncode, done.stderr.strip()) == (0, "[]")


@pytest.mark.slow
def test_a_bench_identification_loads_no_walking_robot(tmp_path: Path) -> None:
    reading = {"position": 0.0, "goal_position": 0.0}
    entries = [{"timestamp": 0.02 * number, **reading} for number in range(20)]
    path = tmp_path / "run.json"
    path.write_text(json.dumps({"mass": 1, "length": 0.1, "kp": 16, "entries": entries}))
    done = run_program(
        "import sys\nfrom hexctl.cli.main import exit_code\n"
        f"assert exit_code(['identify', {str(path)!r}]) == 0\n"
        "print(sum(name.partition('.')[0] == 'hexctl' for name in sys.modules), file=sys.stderr)"
    )
    assert int(done.stderr.split()[-1]) <= 61, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("blocked", "arguments", "extra"),
    [
        ("dm_control", "run --no-record", "sim"),
        ("rerun", "run", "view"),
        ("mujoco", "prior build", "sim"),
        ("pyarrow", "study", "study"),
        ("reportlab", "see print", "see"),
        ("cv2", "see calibrate board.png", "see"),
    ],
)
def test_a_missing_extra_is_named(blocked: str, arguments: str, extra: str, tmp_path: Path) -> None:
    done = run_program(
        f"import sys\nsys.modules[{blocked!r}] = None\nfrom hexctl.cli.main import exit_code\n"
        f"sys.exit(exit_code({arguments.split()!r}))"
    )
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert f"[{extra}]" in done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@pytest.mark.slow
def test_a_robots_computer_needs_no_extras() -> None:
    done = run_program(
        "import sys\nfor name in ('mujoco', 'dm_control', 'rerun', 'scipy'): sys.modules[name] = None\n"
        "from hexctl.cli.main import exit_code\n"
        "assert exit_code(['check', 'phantomx']) == 0\n"
        "sys.exit(exit_code(['run', '--backend', 'mock', '--no-record', '--duration', '0.1']))"
    )
    assert done.returncode == 0, done.stderr


def test_version(call: Call) -> None:
    assert call("--version").out.startswith("hexctl 0.")


TLS = "--connect tls/127.0.0.1:9"

#: Command lines that take a path, for which `{}` stands; whatever path of a file that is not there it is,
#: each ends before anything moves.
PATH_LINES = (
    "run --robot {}.yaml",
    "run --no-record --world {}.yaml",
    "run --backend mock --duration 0.1 --record {}.rrd",
    f"run --no-record --backend zenoh --keys {{}} {TLS}",
    "adapt --failed-leg 5 --prior {}.npz",
    "adapt --failed-leg 5 --backend mock --arena {}.yaml",
    "drive --gamepad {}",
    "drive --page 0.0.0.0:9 --page-keys {}",
    "view {}",
    "export {} --to csv",
    "export ant --to urdf -o {}.urdf",
    "check {}.yaml",
    "calibrate {}.yaml --backend mavlink",
    "sim board --keys {}",
    "serve --backend mock --link {}.yaml",
    "serve --backend feetech --robot phantomx --port {}",
    "serve --backend mock --keys {} --listen tls/127.0.0.1:9",
    "status --link {}.yaml",
    f"estop --keys {{}} {TLS}",
    "study --out {}",
    "sessions show {}",
    "robot import {}.urdf --output new.yaml",
    "see print --output {}.pdf",
    "see calibrate {}.png",
    "sim camera --lens {}.yaml",
    "servos scan --robot {}.yaml",
    "keys new {}",
    "keys mavlink {}",
    "prior build --family {}.yaml",
    "prior build --out {}.npz",
    "prior show {}",
)


@pytest.mark.parametrize("line", PATH_LINES)
def test_a_path_that_no_system_has_is_refused_in_one_line(line: str, tmp_path: Path, call: Call) -> None:
    # A port that is not there is a fault of the robot.
    fault = "--port {}" in line
    path = "x" * 5000 if len(line) % 2 else "a/" * 2500 + "x"
    assert call(*[word.format(path) for word in line.split()], code=3 if fault else 2).refusal
    assert not [found for found in tmp_path.rglob("*") if found.is_file()]


@pytest.mark.parametrize("arguments", ["sessions show", "sessions delete --yes", "view", "check", "export"])
def test_names_that_are_no_utf_8_are_refused_in_one_printable_line(
    arguments: str, tmp_path: Path, call: Call
) -> None:
    (tmp_path / "runs").mkdir()
    call(arguments, os.fsdecode(b"caf\xe9\n"), code=2).line.encode("utf-8")


def test_files_whose_names_are_no_utf_8_are_made_and_read_if_libraries_can(
    tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = os.fsdecode(b"caf\xe9")
    call("robot copy ant", f"{name}.yaml")
    call("check --robot", f"./{name}.yaml")
    call("export", f"./{name}.yaml", "-o", f"{name}.urdf")
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.yaml", f"{name}.urdf"}
    assert call("run --backend mock --duration 1 --record", f"{name}.rrd", code=2).refusal
    monkeypatch.setenv("HEXCTL_RUNS", name)
    assert call("adapt --failed-leg 5 --duration 1 --prior none", code=2).refusal
    assert {path.suffix for path in tmp_path.iterdir()} == {".yaml", ".urdf"}


@pytest.mark.parametrize(
    ("number", "code"), [(errno.ENOSPC, 3), (errno.EDQUOT, 3), (errno.EIO, 3), (errno.EACCES, 2)]
)
def test_a_full_disk_is_a_fault_whatever_was_to_be_written(
    call: Call, number: int, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, _: object = None) -> None:
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr("hexctl.files.sync", refuse)
    call("see print --output", str(tmp_path / "sheet.pdf"), code=code)
    monkeypatch.setattr("hexctl.robot.configs.read_file", refuse)
    call("check ant", code=code)


@pytest.mark.parametrize(
    "command", ["view", "export x --to csv", "adapt --resume x", "sessions list", "demo --budget 1"]
)
def test_a_file_in_place_of_the_runs_is_named(
    command: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("taken").touch()
    monkeypatch.setenv("HEXCTL_RUNS", "taken")
    assert "taken is a file, not a folder" in call(command, code=2).refusal


@pytest.mark.parametrize("there", [True, False], ids=["the runs are read-only", "their folder is"])
@pytest.mark.parametrize(
    ("command", "next_step"),
    [
        ("adapt --failed-leg 5 --duration 3 --prior none", "HEXCTL_RUNS"),
        ("demo", "HEXCTL_RUNS"),
        ("run --duration 1", "--no-record"),
    ],
)
def test_a_folder_that_may_not_be_written_to_comes_with_a_next_step(
    command: str, next_step: str, there: bool, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    if there:
        Path("runs").mkdir()
    may = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK | os.X_OK and may(path, mode))
    refusal = call(command, code=2).refusal
    assert next_step in refusal
    assert "runs/" in refusal


def test_an_argument_of_the_library_has_a_flag(call: Call) -> None:
    call("serve --help")
    flags = {"early_stop": "--early-stop", "target_m": "--target", "credentials": "--keys"}
    assert {name: flag_of(name) for name in flags} == flags
    assert in_flags(InputError(f"{argument('target_m')}: got 9")) == "--target: got 9"
    assert in_flags(InputError("w.yaml: gait: got 5")) == "w.yaml: gait: got 5"


def process(*arguments: str, stdout: int) -> tuple[int, str]:
    """Exit code and stderr of the program, whose results go to a file descriptor."""
    command = [sys.executable, "-m", "hexctl", *arguments]
    done = subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, timeout=60, check=False)
    return done.returncode, done.stderr.decode()


@pytest.mark.parametrize(
    ("error", "named"),
    [
        (ImportError("a.so: failed to map segment from shared object"), "memory"),
        (MemoryError(), "memory"),
        (RuntimeError("can't start new thread"), "memory"),
        (ImportError("libGL.so.1: cannot open shared object file: no", name="cv2"), "install libGL.so.1"),
        (ImportError("cannot import name 'x' from 'numpy' (x.py)", name="numpy"), "numpy"),
    ],
)
def test_low_memory_and_a_broken_library_are_faults_and_no_missing_extra(
    error: Exception, named: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("hexctl.cli.robot.robot_command.config_names", fail)
    refusal = call("robot list", code=3).refusal
    assert named in refusal
    assert ("memory" in refusal, "extra" in refusal) == (named == "memory", False)
    caught = [path for path in PACKAGE.rglob("*.py") if "except ImportError" in path.read_text()]
    assert not caught, "a library that does not load is not missing; allowed: except ModuleNotFoundError"


@pytest.mark.parametrize("closed", ["<&- >&-", ">&-", ">&- 2>&-"])
@pytest.mark.slow
def test_closed_streams_are_discarded_and_given_to_no_file(closed: str) -> None:
    program = "import os, sys; from hexctl.cli.entry import open_closed_streams as o; o(); print(1); "
    program += "file = open(os.devnull); sys.exit(file.fileno() <= 2 or not os.get_inheritable(1))"
    assert (
        subprocess.run(["/bin/sh", "-c", f'"$0" -c "$1" {closed}', sys.executable, program]).returncode == 0
    )


@pytest.mark.slow
def test_a_reader_that_has_gone_is_no_error_and_a_full_disk_is_a_fault() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    assert process("check", "ant", stdout=writing) == (0, "")
    os.close(writing)
    if Path("/dev/full").exists():
        for arguments in (("check", "ant"), ("run", "--help")):
            with open("/dev/full", "wb") as full:
                code, said = process(*arguments, stdout=full.fileno())
            assert (code, os.strerror(errno.ENOSPC) in said, said.count("\n")) == (3, True, 1)


@pytest.mark.parametrize("name", MAY_HANG)
def test_a_module_that_may_hang_exists(name: str) -> None:
    """Programs would wait for ever at their end for one that was renamed."""
    assert find_spec(f"hexctl.{name}") is not None
