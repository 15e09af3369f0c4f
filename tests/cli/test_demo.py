"""`hexctl demo`, `diagnose` and `doctor` as a user calls them."""

from pathlib import Path
from typing import Any

import pytest

from hexctl.cli.console import StopOnInterrupt
from hexctl.cli.prompts import LegPrompt
from tests.cli.conftest import Call
from tests.cli.terminals import type_in


@pytest.fixture(autouse=True)
def _without_a_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


@pytest.mark.slow
def test_ctrl_c_ends_it(call: Call, monkeypatch: Any) -> None:
    monkeypatch.setattr(StopOnInterrupt, "requested", lambda _: True)
    printed = call("demo", code=130)
    assert "with recovery" not in printed.out
    assert not list(Path("runs").iterdir())


ECHO = "tests.runs.test_run:Echo"


@pytest.mark.slow
def test_the_table_says_which_leg_and_why_and_a_recording_is_left(tmp_path: Path, call: Call) -> None:
    printed = call("diagnose --failure 5:limp:femur").out
    (line,) = [line for line in printed.splitlines() if line.startswith("5 ")]
    assert "limp:femur" in line
    (recording,) = (tmp_path / "runs").glob("*.rrd")
    assert "diagnosis" in recording.name
    assert str(recording.relative_to(tmp_path)) in printed


def test_servos_that_echo_and_no_terminal_are_one_line(call: Call) -> None:
    printed = call("diagnose --backend", ECHO, "--no-record")
    assert "not known" in printed.out
    assert len(printed.err.splitlines()) == 1


def test_the_operator_answers_in_words_and_is_asked_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    type_in(monkeypatch, "yes\nperhaps\nno\nquit\n")
    prompt = LegPrompt()
    assert [prompt.moved(1), prompt.moved(2), prompt.moved(3)] == [True, False, None]
    assert "'perhaps'" in capsys.readouterr().err


def test_an_input_that_ends_ends_the_questions(monkeypatch: pytest.MonkeyPatch) -> None:
    type_in(monkeypatch, "")
    assert LegPrompt().moved(1) is None


@pytest.mark.slow
@pytest.mark.parametrize(("failure", "leg"), [("5:limp", 5), ("3:weak:0.9", None)])
def test_a_walk_finds_its_failed_leg_first(failure: str, leg: int | None, call: Call) -> None:
    """One that is not found is still what the simulation breaks."""
    walk = ["run", "--gait", "auto", "--duration", "0.5", "--no-record", "--json", "--failed-leg", "auto"]
    printed = call(*walk, "--failure", failure)
    outcome = printed.json
    assert outcome["failed_leg"] == leg
    assert leg is not None or "leg 3 weak:0.9" in printed.err


@pytest.mark.slow
def test_doctor_says_what_works_and_which_settings_are_in_force_and_what_is_wrong(
    monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    Path("hexctl.toml").write_text("robot = 'pexod'\nconnect = 'tls/secret.lab:7447'\n[run]\nduraton = 3\n")
    for name in ("HEXCTL_OTHERS", "HEXCTL_PRIOR_BUILD_WORLDS", "HEXCTL_RUN_DURATON"):
        monkeypatch.setenv(name, "3")
    printed = call("doctor")
    facts, _, works = printed.out.partition("\nwhat works\n")
    rows = dict(line.split("  ", 1) for line in facts.splitlines())
    assert list(rows)[:4] == ["hexctl", "python", "system", "processor"]
    assert "robot = pexod, connect = given, run.duraton = 3" in rows["settings"]
    assert "HEXCTL_OTHERS" in rows["unknown variables"]
    assert "HEXCTL_PRIOR_BUILD_WORLDS" not in rows["unknown variables"]
    assert "secret.lab" not in printed.out + printed.err
    assert printed.err.startswith("hexctl: HEXCTL_RUN_DURATON: ")
    answers = {line.split("  ")[0]: line.split("  ", 1)[1].strip() for line in works.splitlines()}
    assert answers["simulate walks"] == "yes"
    assert all(answer == "yes" or answer.startswith("NO: ") for answer in answers.values())
    report = call("doctor --json").json
    assert report["works"]["simulate walks"] is None
    assert "HEXCTL_PRIOR_BUILD_WORLDS" in {one["key"] for one in report["settings"]["values"]}
    assert {"HEXCTL_OTHERS", "HEXCTL_RUN_DURATON"} <= {*report["settings"]["unknown"]}
