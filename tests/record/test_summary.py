"""The text panel and the properties of a recording."""

from pathlib import Path

from hexctl.record import paths
from hexctl.record.recording import Recording
from tests.record.conftest import ReadBack, Trial


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
