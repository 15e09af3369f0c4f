"""What every command prints: results on stdout, a reader that closes the pipe, and Ctrl-C."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hexctl.cli.console import StatusLine, StopOnInterrupt, flag_of, in_flags, print_result
from hexctl.cli.main import exit_code
from hexctl.cli.render.tables import label_table, plain_table
from hexctl.errors import InputError, argument
from hexctl.signals import ending_signals
from tests.cli.terminals import OnTerminal
from tests.server.processes import ROOT


def _hexctl(*arguments: str, **more: object) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "hexctl", *arguments]
    return subprocess.Popen(command, stderr=subprocess.PIPE, **more)  # type: ignore[call-overload,no-any-return]


@pytest.mark.slow
def test_a_reader_that_has_gone_is_no_error() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    process = _hexctl("check", "ant", stdout=writing)
    os.close(writing)
    assert process.communicate(timeout=60)[1] == b""
    assert process.returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_result_that_cannot_be_written_is_a_fault() -> None:
    with open("/dev/full", "wb") as full:
        process = _hexctl("check", "ant", stdout=full)
        said = process.communicate(timeout=60)[1].decode()
    assert process.returncode == 3
    assert "the result cannot be printed: No space left on device" in said


@pytest.mark.parametrize(
    ("name", "flag"),
    [
        ("seed", "--seed"),
        ("early_stop", "--early-stop"),
        ("target_m", "--target"),
        ("sit_after_s", "--sit-after"),
        ("heading_deg", "--heading"),
        ("credentials", "--keys"),
    ],
)
def test_an_argument_of_the_library_has_a_flag(name: str, flag: str) -> None:
    assert exit_code(["serve", "--help"]) == 0  # its options are known then
    assert flag_of(name) == flag


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
    "number",
    [
        *(signal.SIGUSR1, signal.SIGUSR2, signal.SIGIO, signal.SIGALRM, signal.SIGVTALRM),
        *(signal.SIGPROF, signal.SIGXCPU, signal.SIGPWR, signal.SIGRTMIN, signal.SIGRTMAX),
    ],
)
def test_whatever_would_end_a_command_asks_for_a_stop_however_often_it_comes(number: signal.Signals) -> None:
    program = f"""
import os
from hexctl.cli.console import StopOnInterrupt
with StopOnInterrupt() as interrupt:
    for _ in range(3):
        os.kill(os.getpid(), {int(number)})
    assert interrupt.requested()
print("softly")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, "softly\n"), done.stderr


def test_a_signal_that_is_ignored_stays_so_and_one_of_another_meaning_is_left_alone() -> None:
    before = signal.signal(signal.SIGUSR1, signal.SIG_IGN)
    try:
        taken = ending_signals()
    finally:
        signal.signal(signal.SIGUSR1, before)
    left = {signal.SIGUSR1, signal.SIGPIPE, signal.SIGTSTP, signal.SIGCHLD, signal.SIGSEGV, signal.SIGABRT}
    assert not left & set(taken)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (f"{argument('gait')}: got 800", "--gait: got 800"),
        (f"{argument('target_m')}: got 9", "--target: got 9"),
        ("w.yaml: gait: got 5", "w.yaml: gait: got 5"),
    ],
)
def test_a_message_names_options_by_their_flags(message: str, text: str) -> None:
    assert in_flags(InputError(message)) == text


@pytest.mark.parametrize(("plain", "again"), [(True, "at once"), (False, "without a soft stop")])
def test_a_soft_stop_is_mentioned_where_there_is_one(plain: bool, again: str) -> None:
    program = f"""
import os, signal, sys
from hexctl.cli.console import StopOnInterrupt
sys.stderr.isatty = lambda: True
with StopOnInterrupt(plain={plain}) as interrupt:
    os.kill(os.getpid(), signal.SIGINT)
    assert interrupt.requested()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, f"\nstopping; press Ctrl-C again to quit {again}\n")


def test_a_status_is_rewritten_on_a_terminal_and_a_line_each_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with StatusLine() as line:
        line.show("one")
        line.show("two")
    assert capsys.readouterr().err == "one\ntwo\n"
    program = (
        "from hexctl.cli.console import StatusLine\n"
        "with StatusLine() as line:\n"
        "    line.show('one'); line.show('two'); line.print_above('news'); line.show('three' * 100)\n"
    )
    terminal = OnTerminal([], tmp_path, program=program, variables={"PYTHONPATH": str(ROOT)})
    try:
        shown = terminal.wait("three")
        assert terminal.code() == 0
    finally:
        terminal.end()
    assert "one\r\x1b[Ktwo" in shown
    assert re.search(r"two\r?\nnews\r?\n", shown)
    assert max(len(row) for row in re.split(r"[\r\n]+", shown)) <= 80 + len("\x1b[K")
