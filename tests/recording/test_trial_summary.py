"""The text panel and the properties of a recording."""

from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.control.trial_plan import GaitChange
from hexctl.control.trial_result import TrialResult
from hexctl.gait.gait import make_gait
from hexctl.gait.posture import Posture
from hexctl.recording import paths
from hexctl.recording.recording import Recording
from hexctl.recording.trial_summary import make_markdown, make_properties
from tests.recording.conftest import ReadBack, Trial


def test_the_text_tells_everything_once(trial: Trial, tmp_path: Path) -> None:
    facts = {"robot": "ant", "gait": {"name": "57"}, "failed_leg": 5, "status": "ok", "world": None}
    facts |= {"seed": 7, "tick_us": {"p50": 1.5, "p99": 3.0}}
    path = tmp_path / "told.rrd"
    with Recording(path, trial.robot, trial.plan, title="told", floor=trial.floor) as recording:
        recording.write_block(trial.log, 0, len(trial.log))
        recording.finish(trial.result, facts)
    (text,) = ReadBack(path).values(f"/{paths.SUMMARY}", "TextDocument:text")[-1]
    rows = [line.split(" | ")[0].strip("| *") for line in text.splitlines() if line.startswith("| ")][1:]
    assert len(rows) == len(set(rows))
    assert {"result", "deviation", "stability", "failed leg", "gait", "seed", "tick_us"} <= set(rows)
    assert "| tick_us | p50 1.5, p99 3.0 |" in text
    assert "None" not in text


def rows_of(text: str) -> dict[str, str]:
    """The rows of a panel."""
    cells = [line.strip("| ").split(" | ") for line in text.splitlines() if line.count("|") == 3]
    return {cell[0].strip("*"): cell[1] for cell in cells if len(cell) == 2}


@pytest.mark.parametrize(
    ("held", "words"),
    [
        ({"hold": "line"}, "the line, by position and yaw"),
        ({"hold": "line", "yaw_change_rad": None}, "the line, by position alone"),
        ({"hold": "line", "hold_lost_s": 3.02}, "the line, by position and yaw; position lost for 3.0 s"),
        ({"hold": "heading", "limited_ticks": 25}, "the heading, by yaw alone; 0.5 s slower than asked for"),
        ({"hold": "none"}, "nothing"),
        ({"hold": "none", "hold_caveat": "no yaw was measured"}, "nothing: no yaw was measured"),
    ],
)
def test_what_was_held_is_said(trial: Trial, held: dict[str, object], words: str) -> None:
    result: TrialResult = replace(trial.result, **held)  # type: ignore[arg-type]
    panel = make_markdown("a walk", trial.robot, trial.plan, result, None, {})
    assert rows_of(panel)["held"].startswith(words)
    properties = make_properties("a walk", trial.robot, trial.plan, result, None, {})
    assert properties["hold"] == held["hold"]
    assert properties.get("hold_caveat") == held.get("hold_caveat")


def test_changes_of_gait_and_posture_are_said_where_there_are_any(trial: Trial) -> None:
    posture = Posture(body_raise=0.012, shift=(0.02, -0.01), tucked_legs=(5,))
    gait = replace(trial.plan.gait, posture=posture, swing_share=0.25)
    change = GaitChange(gait=replace(gait, slots=make_gait(trial.robot, "wave").slots), at_s=1.5)
    plan = replace(trial.plan, gait=gait, changes=(change,))
    told = rows_of(make_markdown("a walk", trial.robot, plan, trial.result, None, {}))
    slots = " ".join(map(str, change.gait.slots))
    assert told["then"].startswith(slots)
    assert told["then"].endswith("at 1.5 s")
    assert told["posture"] == (
        "body 0.012 m higher; over its feet +0.02 m forward, -0.01 m to the left; tucked legs: 5; "
        "feet in the air for 25 % of a cycle"
    )
    properties = make_properties("a walk", trial.robot, plan, trial.result, None, {})
    assert properties["then"] == [f"{slots.replace(' ', ',')}@1.5"]
    plain = rows_of(make_markdown("a walk", trial.robot, trial.plan, trial.result, None, {}))
    assert not {"then", "posture"} & set(plain)
