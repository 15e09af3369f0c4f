"""`hexctl diagnose` as a user calls it."""

import io
import json
import os
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.cli.prompts import LegPrompt

ECHO = "tests.runs.test_diagnosis:Echo"


def test_the_table_says_which_leg_and_why_and_a_recording_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_code(["diagnose", "--failure", "5:limp:femur"]) == 0
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
        (["--failure", "2:bent"], "--failure: got '2:bent'"),
        (["--failure", "2:limp@3"], "--failure: got '2:limp@3'"),
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


def test_a_walk_finds_its_failed_leg_first(capsys: pytest.CaptureFixture[str]) -> None:
    walk = ["run", "--gait", "auto", "--duration", "1", "--no-record", "--json"]
    assert exit_code([*walk, "--failed-leg", "auto", "--failure", "5:limp"]) == 0
    printed = capsys.readouterr()
    outcome = json.loads(printed.out)
    assert (outcome["failed_leg"], outcome["failure"]) == (5, "limp")
    assert outcome["diagnosis"]["verdict"] == "leg 5 limp"
    assert "diagnosis: leg 5 limp" in printed.err


def test_a_walk_of_which_no_leg_has_failed_goes_on_with_six(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["run", "--failed-leg", "auto", "--duration", "1", "--no-record", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["failed_leg"] is None
    assert "no leg has failed" in printed.err


@pytest.mark.slow
def test_what_was_not_found_is_still_what_the_simulation_breaks(capsys: pytest.CaptureFixture[str]) -> None:
    walk = ["run", "--duration", "1", "--no-record", "--json", "--failed-leg", "auto"]
    assert exit_code([*walk, "--failure", "3:weak:0.9"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["failed_leg"] is None
    assert "the simulation breaks leg 3 weak:0.9; the controller is told none" in printed.err


@pytest.mark.slow
def test_a_search_finds_its_failed_leg_first_and_ends_where_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    search = ["adapt", "--failed-leg", "auto", "--optimizer", "random", "--budget", "1", "--duration", "2"]
    shown = ["--no-baseline", "--no-record", "--json"]
    exit_code([*search, *shown, "--failure", "2:locked"])
    printed = capsys.readouterr()
    assert "diagnosis: leg 2 locked" in printed.err
    assert '"failed_leg": 2' in printed.out
    assert exit_code([*search, *shown]) == 2
    assert "no leg has failed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--failure", "limp"], "such as 5:limp"),
        (["--failed-leg", "auto,5"], "--failed-leg: got 'auto,5'"),
        (["--backend", "mock", "--failure", "5:limp"], "allowed: with sim"),
    ],
)
def test_auto_names_what_is_not_allowed(
    arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["run", "--no-record", "--failed-leg", "auto", *arguments]) == 2
    assert named in capsys.readouterr().err
