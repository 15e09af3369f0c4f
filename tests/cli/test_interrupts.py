"""Ctrl-C, hangups and other signals, and what is printed on a terminal and in a pipe."""

import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexctl.cli.console import StopOnInterrupt, print_result
from hexctl.cli.interrupts import NOT_CONFIRMED
from hexctl.cli.progress import StatusLine
from hexctl.cli.render.tables import label_table, plain_table
from hexctl.signals import ending_signals
from tests.cli.conftest import Call
from tests.cli.terminals import WITH_TERMINAL, OnTerminal, run_program, wait_until_it_grows
from tests.server.processes import ROOT, free_port

#: Runs a command, and interrupts it where a module begins to be imported.
PROGRAM = """
import os, signal, sys, time
name, times = sys.argv[1], int(sys.argv[2])
del sys.argv[1:3]
# What starts the tests may have made their processes ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupting:
    left = times
    def find_spec(self, module, path=None, target=None):
        if module == name and Interrupting.left:
            for _ in range(Interrupting.left):
                os.kill(os.getpid(), signal.SIGINT)
                if times > 1:  # as on a busy computer, where the timer expires before it is handled
                    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
                    time.sleep(0.05)
            Interrupting.left = 0
        return None
sys.argv[0] = "hexctl"
from hexctl.cli.entry import main
sys.meta_path.insert(0, Interrupting())
main()
"""

WALK = "run --duration 0.2 --record walk.rrd"


def interrupted(module: str, *, times: int = 1, words: str = WALK) -> "subprocess.CompletedProcess[str]":
    return run_program(PROGRAM, module, str(times), *words.split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "quiet"),
    [
        ("hexctl.cli.main", False),
        ("pydantic_core._pydantic_core", False),
        # Once the walk is asked for, its own soft stop answers, which prints a result.
        ("mujoco._structs", True),
        ("rerun_bindings", True),
    ],
)
def test_ctrl_c_in_an_import_is_one_line_and_130(module: str, quiet: bool) -> None:
    done = interrupted(module)
    assert done.returncode == 130, done.stderr
    assert all(line.startswith("hexctl: ") for line in done.stderr.splitlines())
    assert len(done.stderr.splitlines()) == 1 or (quiet and not done.stderr)
    assert "Traceback" not in done.stdout


@pytest.mark.parametrize("module", ["typer", "hexctl.cli.walk.run_command"])
def test_ctrl_c_before_a_command_says_that_nothing_was_done(module: str, tmp_path: Path) -> None:
    done = interrupted(module)
    assert done.returncode == 130
    assert done.stderr == "hexctl: interrupted before the command began: nothing was done\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_second_one_does_not_wait() -> None:
    done = interrupted("pydantic_core._pydantic_core", times=2)
    assert (done.returncode, done.stderr) == (130, "hexctl: interrupted\n")


@pytest.mark.slow
@pytest.mark.parametrize("module", ["typer", "hexctl.client.stop_client"])
def test_a_stop_that_is_interrupted_says_that_it_has_stopped_nothing(module: str) -> None:
    done = interrupted(module, words="estop --connect tcp/127.0.0.1:9")
    assert (done.returncode, len(done.stderr.splitlines())) == (130, 1)
    assert done.stderr.endswith(f"{NOT_CONFIRMED}\n")


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

#: A walk in a thread, which nobody waits for any more.
DROPPED = """import hexctl.threads
    threading.Thread(target=threading.Event().wait, name="simulate_0").start()
    return 130"""


@pytest.mark.parametrize(
    ("last", "code"),
    [
        ("", 4),
        ("threading.Thread(target=linger).start()", 130),
        pytest.param(DROPPED, 130, marks=pytest.mark.slow),
    ],
    ids=["ended", "a thread lingers", "a walk was dropped"],
)
def test_a_ctrl_c_after_the_end_of_a_command_is_no_signal_and_no_traceback(last: str, code: int) -> None:
    done = run_program(ENDED.format(last=last))
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_a_second_ctrl_c_in_a_walk_names_the_recording(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("hexctl.runs.run.Run.walk", interrupt)
    path = tmp_path / "walk.rrd"
    assert str(path) in call("run --record", str(path), code=130).err
    assert call("run --no-record", code=130).err == "hexctl: interrupted without a soft stop\n"
    assert call("run --no-record --backend mock", code=130).err.endswith(
        f"without a soft stop. {NOT_CONFIRMED}\n"
    )


def test_a_ctrl_c_after_a_walk_is_not_before_it(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("hexctl.runs.run.Run.__exit__", interrupt)
    path = tmp_path / "walk.rrd"
    for record, said in ((["--no-record"], ""), (["--record", str(path)], f"; recorded: {path}")):
        err = call("run --duration 0.2", *record, code=130).err
        assert err.splitlines()[-1] == f"hexctl: interrupted after the walk{said}"


@pytest.mark.parametrize("command", ["run", "sessions list"])
def test_a_ctrl_c_that_a_command_does_not_handle_is_a_line(
    command: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexctl.runs.run.Run.__init__", interrupt)
    monkeypatch.setattr("hexctl.adapt.sessions.store.list_sessions", interrupt)
    assert call(command, code=130).line.endswith("nothing was recorded") is (command == "run")


@pytest.fixture
def _handlers() -> Iterator[None]:
    """The handlers of before, after the test."""
    numbers = (signal.SIGHUP, signal.SIGUSR1, signal.SIGINT)
    before = [signal.getsignal(number) for number in numbers]
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.usefixtures("_handlers")
def test_the_first_ctrl_c_asks_for_a_stop_and_the_second_ends() -> None:
    before = signal.getsignal(signal.SIGINT)
    with StopOnInterrupt() as interrupt:
        assert not interrupt.requested()
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.requested()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(
    "number", [signal.SIGUSR1, signal.SIGIO, signal.SIGALRM, signal.SIGXCPU, signal.SIGPWR, signal.SIGRTMAX]
)
def test_whatever_would_end_a_command_asks_for_a_stop_however_often_it_comes(number: signal.Signals) -> None:
    with StopOnInterrupt() as interrupt:
        for _ in range(3):
            os.kill(os.getpid(), number)
        assert interrupt.requested()
    assert signal.getsignal(number) is signal.SIG_DFL


@pytest.mark.usefixtures("_handlers")
def test_a_signal_that_is_ignored_stays_so_and_one_of_another_meaning_is_left_alone() -> None:
    for number in (signal.SIGUSR1, signal.SIGHUP):  # the latter as under nohup
        signal.signal(number, signal.SIG_IGN)
    taken = ending_signals()
    left = {signal.SIGUSR1, signal.SIGPIPE, signal.SIGTSTP, signal.SIGCHLD, signal.SIGSEGV, signal.SIGABRT}
    assert not {*left, signal.SIGHUP} & set(taken)
    with StopOnInterrupt() as interrupt:
        os.kill(os.getpid(), signal.SIGHUP)
        assert not interrupt.requested()


@pytest.mark.usefixtures("_handlers")
def test_two_hangups_are_one_and_ctrl_c_still_ends() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    with StopOnInterrupt() as interrupt:
        for _ in range(2):  # of the kernel and of a shell
            os.kill(os.getpid(), signal.SIGHUP)
        assert interrupt.requested()
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL


@pytest.mark.parametrize("plain", [True, False])
def test_a_soft_stop_is_mentioned_where_there_is_one(
    plain: bool, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with StopOnInterrupt(plain=plain) as interrupt:
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.requested()
    said = capfd.readouterr().err
    assert ("Ctrl-C" in said, "soft stop" in said) == (True, not plain)


def test_lines_of_a_table_are_not_wrapped_in_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    joints = plain_table("joint", "limit", "")
    joints.add_row("leg1_coxa", "360", "too fast")
    joints.add_row("leg1_femur", "90", "")
    print_result("before", joints, label_table([("status", "word " * 40)]), "after [bold]not markup[/]")
    assert capsys.readouterr().out.splitlines() == [
        "before",
        "joint       limit",
        "leg1_coxa     360  too fast",
        "leg1_femur     90",
        "status     " + ("word " * 40).strip(),
        "after [bold]not markup[/]",
    ]


def test_a_status_is_rewritten_on_a_terminal_and_a_line_each_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with StatusLine() as line:
        line.show("one")
        line.show("two")
    assert capsys.readouterr().err == "one\ntwo\n"
    program = (
        "from hexctl.cli.progress import StatusLine\n"
        "with StatusLine() as line:\n"
        "    line.show('one'); line.show('two'); line.print_above('news'); line.show('three' * 100)\n"
        "print('over')\n"
    )
    with OnTerminal(tmp_path, program=program, variables={"PYTHONPATH": str(ROOT)}) as terminal:
        shown = terminal.wait("over")
        assert terminal.code() == 0
    rows = re.split(r"[\r\n]+", re.sub(r"\x1b\[[\d?]*\w", "", shown))
    assert "news" in rows
    assert max(map(len, rows)) <= 80
    assert "\x1b[2K" not in shown[shown.rindex("three") :], "the last one stays"


@pytest.mark.realtime
def test_a_walk_ends_with_a_soft_stop_and_a_whole_recording(tmp_path: Path) -> None:
    from hexctl.recording.recorded_trial import read_trial

    path = tmp_path / "walk.rrd"
    arguments = ("--realtime", "--duration", "600", "--record", str(path))
    with OnTerminal(tmp_path, *arguments, command="run", program=WITH_TERMINAL) as terminal:
        wait_until_it_grows(path)
        terminal.close()
        assert terminal.code() == 130
    trial = read_trial(path)
    assert trial.phases[-1] == 3  # the soft stop, to its end
    legs_rad = trial.commanded_rad[-1].reshape(6, 3)
    assert (abs(legs_rad - legs_rad[0]) < 1e-3).all(), "it stands on six legs that are bent alike"
    assert (abs(trial.commanded_rad[-1] - trial.commanded_rad[-2]) < 1e-2).all(), "below 0.5 rad/s"


@pytest.mark.realtime
def test_a_search_and_a_server_end_as_by_ctrl_c(
    tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("--failed-leg", "5", "--duration", "20", "--budget", "500", "--no-record")
    with OnTerminal(tmp_path, *arguments, command="adapt", program=WITH_TERMINAL) as terminal:
        terminal.wait(r"session \S+")
        terminal.close()
        assert terminal.code() == 130
    monkeypatch.chdir(tmp_path)
    assert len(call("sessions list --json").json) == 1
    served = ("--backend", "mock", "--listen", f"tcp/127.0.0.1:{free_port()}")
    with OnTerminal(tmp_path, *served, command="serve", program=WITH_TERMINAL) as terminal:
        terminal.wait("serving|listens|at tcp")
        terminal.close()
        assert terminal.code() == 0
