"""The program: help, version, missing extras, and bad input.

Bad input exits with 2 and prints one line with what, got and allowed; nothing walks.
"""

import errno
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.robot.configs import config_names
from tests.cli.paths import PATH_LINES

HEAVY = ("mujoco", "dm_control", "rerun", "numpy", "pydantic", "yaml", "scipy")


def python(code: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("command", ["show", "compare", "export", "delete"])
def test_a_session_that_is_missing_comes_with_the_command_that_lists_them(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["sessions", command]) == 2
    assert "hexctl sessions list" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["adapt", "run"])
def test_the_paragraphs_of_a_help_text_fill_the_terminal(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert exit_code([command, "--help"]) == 0
    described = [line.strip() for line in capsys.readouterr().out.partition(":\n  --")[0].splitlines()[:-1]]
    assert max(map(len, described)) > 70
    for line, following in pairwise(described):
        if line and following:
            word = following.split()[0]
            assert len(f"{line} {word}") > 75, f"{word} has room behind: {line}"


def test_help_loads_nothing_heavy() -> None:
    done = python(
        "import sys\nfrom hexctl.cli.main import exit_code\n"
        "assert exit_code(['--help']) == 0\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    assert done.returncode == 0
    assert "run" in done.stdout
    assert done.stderr.strip() == "[]"


def test_importing_hexctl_loads_nothing() -> None:
    done = python(f"import sys, hexctl\nprint([name for name in {HEAVY!r} if name in sys.modules])")
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("blocked", "arguments", "extra"),
    [
        ("dm_control", ["run", "--no-record"], 'pip install "hexctl[sim]"'),
        ("mujoco", ["run", "--no-record"], 'pip install "hexctl[sim]"'),
        ("rerun", ["run"], 'pip install "hexctl[view]"'),
        ("mujoco", ["study"], 'pip install "hexctl[sim]"'),
        ("mujoco", ["study", "--transfer"], 'pip install "hexctl[sim]"'),
        ("mujoco", ["prior", "build"], 'pip install "hexctl[sim]"'),
        ("pyarrow", ["study"], 'pip install "hexctl[study]"'),
        ("reportlab", ["see", "print"], 'pip install "hexctl[see]"'),
        ("cv2", ["see", "calibrate", "board.png"], 'pip install "hexctl[see]"'),
        ("cv2", ["see", "latency", "--camera", "0"], 'pip install "hexctl[see]"'),
    ],
)
def test_a_missing_extra_is_named(blocked: str, arguments: list[str], extra: str) -> None:
    done = python(
        f"import sys, os, tempfile\nos.chdir(tempfile.mkdtemp())\nsys.modules[{blocked!r}] = None\n"
        f"from hexctl.cli.main import exit_code\ncode = exit_code({arguments!r})\n"
        "assert os.listdir() in ([], ['runs']) and (not os.path.isdir('runs') or not os.listdir('runs'))\n"
        "sys.exit(code)"
    )
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert extra in done.stderr


@pytest.mark.slow
def test_a_robots_computer_needs_no_extras() -> None:
    done = python(
        "import sys\nfor name in ('mujoco', 'dm_control', 'rerun', 'scipy'): sys.modules[name] = None\n"
        "from hexctl.cli.main import exit_code\n"
        "assert exit_code(['check', 'phantomx']) == 0\n"
        "sys.exit(exit_code(['run', '--backend', 'mock', '--no-record', '--duration', '0.1']))"
    )
    assert done.returncode == 0, done.stderr


def test_version() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hexctl", "--version"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.startswith("hexctl 0.")


REFUSED = [
    (["run", "--robot", "bob"], ["robot", "'bob'", ", ".join(config_names("robots"))]),
    (["run", "--robot", "/nowhere/bob.yaml"], ["/nowhere/bob.yaml", ", ".join(config_names("robots"))]),
    (["run", "--world", "mars"], ["world", "'mars'", "rough, slippery, slope"]),
    (["run", "--gait", "0"], ["--gait", "0", "1..720"]),
    (["run", "--gait", "721"], ["--gait", "721", "1..720"]),
    (["run", "--gait", "121", "--failed-leg", "2"], ["--gait", "121", "1..120", "leg 2"]),
    (["run", "--gait", "gallop"], ["gait", "'gallop'", "demo, tripod, wave, ripple"]),
    (["run", "--gait", "1,2,3,3,4,5"], ["1,2,3,3,4,5", "permutation"]),
    (["run", "--gait", "1,2,3"], ["1,2,3", "permutation"]),
    (["run", "--gait", "1,2,x,4,5,6"], ["1,2,x,4,5,6", "whole numbers"]),
    (["run", "--duration", "nan"], ["duration", "nan", "above 0"]),
    (["run", "--duration", "-4"], ["duration", "-4", "above 0"]),
    (["run", "--duration", "abc"], ["--duration", "number"]),
    (["run", "--heading", "nan"], ["--heading", "nan", "finite"]),
    (["run", "--turn", "inf"], ["--turn", "inf", "-360 to 360"]),
    (["run", "--turn", "4000"], ["--turn", "4000", "360"]),
    (["run", "--turn", "300"], ["leg", "foot", "--turn"]),
    (["run", "--record", "walk.txt"], ["walk.txt", ".rrd"]),
    (["check", "ant", "--robot", "pexod"], ["ant", "pexod"]),
    (["run", "--pace", "0"], ["pace", "0", "up to 10"]),
    (["run", "--amplitude", "0.6"], ["leg 1", "allowed"]),
    (["run", "--height", "-1"], ["height", "-1", "allowed"]),
    (["run", "--failed-leg", "7"], ["--failed-leg", "7", "1..6"]),
    (["run", "--failure", "limp"], ["--failure", "limp", "5:limp"]),
    (
        ["run", "--failure", "1:sad"],
        ["failure", "sad", "locked, limp[:JOINT], missing"],
    ),
    (["run", "--failure", "1:stuck:knee:3"], ["knee", "coxa, femur, tibia"]),
    (["run", "--failure", "1:weak:2"], ["weak", "2", "0..1"]),
    (["run", "--self-rotation", "up"], ["self-rotation", "up", "rear, front, none"]),
    (
        ["run", "--backend", "warp"],
        ["backend", "'warp'", "sim, zenoh, mavlink, dynamixel, feetech, lx16a, servo2040, pca9685, mock"],
    ),
    (["run", "--backend", "json:JSONDecoder"], ["json:JSONDecoder", "LegServos"]),
    (["run", "--backend", "no.such:Thing"], ["no.such:Thing", "cannot be loaded"]),
    (["run", "--backend", "mock", "--world", "rough"], ["--world", "rough", "sim"]),
    (["run", "--seed", "-1"], ["--seed", "-1", "0 or more"]),
    (["run", "--no-record", "--view"], ["--no-record", "--view"]),
    (["run", "--colour", "red"], ["--colour"]),
    (["walk"], ["walk"]),
    (["check", "--gait", "999"], ["--gait", "999", "1..720"]),
    (["check", "nobody"], ["robot", "'nobody'", "ant"]),
    (["view", "/nowhere/x.rrd"], ["/nowhere/x.rrd"]),
]


@pytest.mark.parametrize(("arguments", "words"), REFUSED, ids=lambda value: " ".join(value)[:40])
def test_refused_in_one_line(
    arguments: list[str],
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_code(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    for word in words:
        assert word in printed.err
    assert list(tmp_path.iterdir()) == []


BAD_FILES = {
    "not a mapping": b"- 1\n- 2\n",
    "a number": b"42\n",
    "broken YAML": b"name: [ant\n",
    "binary junk": bytes(range(256)) * 4,
    "a tag": b"!!python/object/apply:os.system ['true']\n",
    "unknown key": b"frictoin: 1\n",
    "not finite": b"friction: .nan\n",
    "wrong type": b"friction: slippery\n",
}


@pytest.mark.parametrize("option", ["--robot", "--world"])
@pytest.mark.parametrize("content", BAD_FILES.values(), ids=BAD_FILES.keys())
def test_bad_files_name_the_file(
    option: str, content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    assert exit_code(["run", "--no-record", option, str(path)]) == 2
    printed = capsys.readouterr()
    assert len(printed.err.splitlines()) == 1
    assert str(path) in printed.err


def test_an_existing_recording_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "kept.rrd"
    path.write_bytes(b"precious")
    assert exit_code(["run", "--record", str(path)]) == 2
    assert path.read_bytes() == b"precious"
    assert str(path) in capsys.readouterr().err


@pytest.mark.parametrize("place", ["/proc/walk.rrd", "/dev/null/walk.rrd", "."])
def test_an_unwritable_recording_is_refused(place: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["run", "--record", place]) == 2
    printed = capsys.readouterr()
    assert len(printed.err.splitlines()) == 1
    assert place in printed.err


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["run", "--seed", "-1"], "hexctl: --seed: got -1; allowed: 0 or more"),
        (["run", "--seed", "x"], "hexctl: --seed: got 'x'; allowed: a whole number, 0 or more"),
        (["adapt", "--self-rotation", "up"], "hexctl: --self-rotation: got up; allowed: rear, front, none"),
        (["sim", "board", "--backend", "zenoh"], "hexctl: --backend: got zenoh; allowed: sim, mock"),
        (["run", "--recrod", "x"], "hexctl: No such option: --recrod (Possible options: --record)"),
    ],
    ids=lambda value: " ".join(value)[:40],
)
def test_a_bad_value_names_option_value_and_range(
    arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(arguments) == 2
    assert capsys.readouterr().err.splitlines()[0].startswith(line.partition(" (")[0])


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["run", "--record", "x.txt"], "hexctl: --record: got x.txt; allowed: a name that ends in .rrd"),
        (["run", "--backend", "foo"], "hexctl: --backend: got 'foo'; allowed: sim, zenoh,"),
        (
            ["run", "--backend", "zenoh", "--connect", "banana"],
            "hexctl: --connect: got 'banana'; allowed: PROTO",
        ),
        (["status", "--connect", "banana"], "hexctl: --connect: got 'banana'; allowed: PROTOCOL/HOST:PORT"),
        (["serve", "--listen", "banana"], "hexctl: --listen: got 'banana'; allowed: PROTOCOL/HOST:PORT"),
        (["run", "--world", "transfer:-1"], "hexctl: --world: got 'transfer:-1'; allowed: the number of"),
        (["adapt", "--failed-leg", "5", "--optimizer", "bays"], "hexctl: --optimizer: got 'bays'; allowed:"),
        (["adapt", "--resume", "nosuch"], "hexctl: --resume: got 'nosuch'; allowed: none yet, "),
        (["export", "nosuch", "--to", "csv"], "hexctl: session: got 'nosuch'; allowed: none yet, "),
        (["run", "--robot", "/dev"], "hexctl: '/dev' is a folder; allowed: a YAML file, or one of ant,"),
        (["run", "--world", "kept"], "hexctl: 'kept' is a folder; allowed: a YAML file, or one of flat,"),
        (
            ["run", "--robot", "r" * 5001],
            f"hexctl: unknown robot '{'r' * 200}... (5001 characters)'; allowed:",
        ),
        (["run", "--seed", "s" * 5001], f"hexctl: --seed: got '{'s' * 200}... (5001 characters)'; allowed:"),
        (["run", "--world", "w" * 5001 + ":7"], f"hexctl: unknown world '{'w' * 200}... (5001 characters)'"),
        (["run", "--duraton", "5"], "hexctl: No such option: --duraton (Possible options: --duration)"),
    ],
    ids=lambda value: " ".join(value)[:40],
)
def test_a_message_names_the_option_and_shows_no_long_value(
    arguments: list[str],
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "kept").mkdir()
    monkeypatch.chdir(tmp_path)
    assert exit_code(arguments) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(line)


#: A command that has ended, in a process that takes its time to end; another Ctrl-C comes at some point.
ENDED = """
import atexit, os, signal, threading, time
import hexctl.cli.main
from hexctl.cli.entry import main

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)

def linger():
    time.sleep(0.2)
    interrupt()
    time.sleep(5)

def end():
    {last}
    return 4

hexctl.cli.main.exit_code = end
atexit.register(interrupt)
main()
"""


@pytest.mark.parametrize(("last", "code"), [("", 4), ("threading.Thread(target=linger).start()", 130)])
def test_a_ctrl_c_after_the_end_of_a_command_is_no_signal_and_no_traceback(last: str, code: int) -> None:
    process = [sys.executable, "-c", ENDED.format(last=last)]
    done = subprocess.run(process, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


@pytest.mark.slow
def test_an_interrupted_command_does_not_wait_for_walks_that_were_dropped() -> None:
    program = (
        "import threading\n"
        "import hexctl.cli.main, hexctl.study.walking\n"
        "from hexctl.cli.entry import main\n"
        "def end():\n"
        "    threading.Thread(target=threading.Event().wait, name='simulate_0').start()\n"
        "    return 130\n"
        "hexctl.cli.main.exit_code = end\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], check=False, timeout=60)
    assert done.returncode == 130


def test_a_ctrl_c_before_a_command_is_loaded_says_that_nothing_was_recorded() -> None:
    program = (
        "import os, signal, sys\n"
        # What starts the tests may have made their processes ignore it.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'hexctl.cli.main':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "from hexctl.cli.entry import main\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "hexctl: interrupted before the command began: nothing was recorded\n"


def test_a_second_ctrl_c_in_a_walk_names_the_recording(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hexctl.runs.run.Run.walk", interrupted)
    path = tmp_path / "walk.rrd"
    assert exit_code(["run", "--record", str(path)]) == 130
    line = f"hexctl: interrupted without a soft stop; recorded until then: {path}\n"
    assert capsys.readouterr().err == line
    assert exit_code(["run", "--no-record"]) == 130
    assert capsys.readouterr().err == "hexctl: interrupted without a soft stop\n"


@pytest.mark.parametrize("command", [["run"], ["sessions", "list"]])
def test_a_ctrl_c_that_a_command_does_not_handle_is_a_line(
    command: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hexctl.runs.run.Run.__init__", interrupted)
    monkeypatch.setattr("hexctl.adapt.sessions.store.list_sessions", interrupted)
    assert exit_code(command) == 130
    assert capsys.readouterr().err == "hexctl: interrupted\n"


@pytest.mark.parametrize("path", ["x" * 5000, "a/" * 2500 + "x"], ids=["name", "folders"])
@pytest.mark.parametrize("line", PATH_LINES)
def test_a_path_that_no_system_has_is_refused_in_one_line(
    line: str, path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    # A port that is not there is a fault of the robot.
    fault = "--connect {}" in line or "--connect {}" in line
    assert exit_code([word.format(path) for word in line.split()]) == (3 if fault else 2)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert not [found for found in tmp_path.rglob("*") if found.is_file()]


@pytest.mark.parametrize(
    "arguments", [["sessions", "show"], ["sessions", "delete", "--yes"], ["view"], ["check"], ["export"]]
)
def test_names_that_are_no_utf_8_are_refused_in_one_printable_line(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    assert exit_code([*arguments, os.fsdecode(b"caf\xe9\n")]) == 2
    line = capsys.readouterr().err
    assert len(line.splitlines()) == 1
    line.encode("utf-8")


@pytest.mark.parametrize(
    ("number", "code"), [(errno.ENOSPC, 3), (errno.EDQUOT, 3), (errno.EIO, 3), (errno.EACCES, 2)]
)
def test_a_full_disk_is_a_fault_whatever_was_to_be_written(
    number: int,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def refuse(path: Path, _: object) -> None:
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr("hexctl.vision.sheet.atomic_write", refuse)
    assert exit_code(["see", "print", "--output", str(tmp_path / "sheet.pdf")]) == code
    assert os.strerror(number) in capsys.readouterr().err
    monkeypatch.setattr("hexctl.robot.configs.read_file", lambda path, most: refuse(path, most))
    assert exit_code(["check", "ant"]) == code


@pytest.mark.parametrize(
    ("arguments", "proposed"),
    [(["run", "--robot", "phantom"], "phantomx"), (["run", "--world", "slipery"], "slippery"),
     (["run", "--backend", "dynamixl"], "dynamixel"), (["run", "--gait", "Tripot"], "tripod"),
     (["run", "--failure", "5:mising"], "missing")],
)  # fmt: skip
def test_a_name_that_is_near_is_proposed(
    arguments: list[str], proposed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(arguments) == 2
    assert capsys.readouterr().err.endswith(f"; did you mean '{proposed}'?\n")


def test_names_are_taken_in_any_case(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["check", "Ant", "--gait", "Tripod"]) == 0
    assert exit_code(["run", "--backend", "Mock", "--world", "flat"]) == 2
    assert "--backend mock" in capsys.readouterr().err


@pytest.mark.parametrize(
    "asked", [["-h"], ["help"], ["run", "-h"], ["help", "run"], ["help", "sim", "board"]]
)
def test_help_is_asked_for_in_any_usual_way(asked: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(asked) == 0
    shown = capsys.readouterr().out
    assert "Usage: hexctl" in shown
    assert "--help, -h " in shown
