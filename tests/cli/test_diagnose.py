"""`hexctl diagnose` as a user calls it."""

import io
import json
import os
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.cli.prompts import LegPrompt

ECHO = "tests.record.test_diagnosis:Echo"


def test_the_table_says_which_leg_and_why_and_a_recording_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_code(["diagnose", "--failed-leg", "5", "--failure", "limp:femur"]) == 0
    printed = capsys.readouterr().out
    (line,) = [line for line in printed.splitlines() if line.startswith("5 ")]
    assert "limp:femur" in line
    assert "gives no torque" in line
    assert "leg 5 limp:femur" in printed
    (recording,) = (tmp_path / "runs").glob("*.rrd")
    assert "diagnosis" in recording.name
    assert str(recording.relative_to(tmp_path)) in printed


def test_json_is_one_object_with_a_finding_for_each_leg(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["diagnose", "--failed-leg", "2", "--no-record", "--json"]) == 0
    outcome = json.loads(capsys.readouterr().out)
    assert outcome["failures"] == [{"leg": 2, "failure": "locked"}]
    assert [leg["leg"] for leg in outcome["legs"]] == [1, 2, 3, 4, 5, 6]
    assert outcome["recording"] is None


def test_servos_that_echo_and_no_terminal_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["diagnose", "--backend", ECHO, "--no-record"]) == 0
    printed = capsys.readouterr()
    assert "not known" in printed.out
    assert "on a terminal" in printed.err


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--backend", "mock", "--failed-leg", "2"], "--failed-leg: got 2 with --backend mock"),
        (["--no-record", "--record", "x.rrd"], "--no-record"),
        (["--failed-leg", "2", "--failure", "bent"], "--failure: got bent"),
    ],
)
def test_what_is_not_allowed_is_named(
    arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["diagnose", *arguments]) == 2
    assert named in capsys.readouterr().err


def _typed(text: str, monkeypatch: pytest.MonkeyPatch) -> LegPrompt:
    reading, writing = os.pipe()
    os.write(writing, text.encode())
    os.close(writing)
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(os.fdopen(reading, "rb")))
    return LegPrompt()


def test_the_operator_answers_in_words_and_is_asked_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    prompt = _typed("yes\nperhaps\nno\nquit\n", monkeypatch)
    assert [prompt.moved(1), prompt.moved(2), prompt.moved(3)] == [True, False, None]
    assert "got 'perhaps'; allowed: yes, no, quit" in capsys.readouterr().err


def test_an_input_that_ends_ends_the_questions(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _typed("", monkeypatch).moved(1) is None
