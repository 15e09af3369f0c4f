"""Steering the viewer, with a program in the place of Rerun's that speaks as it does."""

import json
import sys
from pathlib import Path

import pytest

from hexctl.errors import RecordingError
from hexctl.record import viewercontrol
from hexctl.record.viewercontrol import ViewerControl

#: Refuses to connect at first, then loads a recording per question up to a number, and notes what it is told.
PROGRAM = """#!{python}
import json, sys
from pathlib import Path
connects = questions = 0
for line in sys.stdin:
    asked = json.loads(line)
    if "id" not in asked:
        continue
    said = {{}}
    if asked["method"] == "tools/call":
        tool, arguments = asked["params"]["name"], asked["params"]["arguments"]
        if tool == "rerun_connect":
            connects += 1
            said = {{"isError": connects < 3, "content": [{{"type": "text", "text": "{{}}"}}]}}
        elif tool == "rerun_get_state":
            questions += 1
            number = min(questions, {number})
            seen = [{{"store_id": f"Recording:x:id-{{i}}", "location": f"at-{{i}}"}} for i in range(number)]
            said = {{"content": [{{"type": "text", "text": json.dumps({{"recordings": seen}})}}]}}
        else:
            Path({told!r}).write_text(json.dumps([questions, tool, arguments]))
            said = {{"content": [{{"type": "text", "text": "{{}}"}}]}}
    print(json.dumps({{"method": "notifications/message"}}))
    print(json.dumps({{"id": asked["id"], "result": said}}), flush=True)
"""


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewercontrol, "POLL_S", 0.0)
    monkeypatch.setattr(viewercontrol, "SETTLED_S", 0.2)


def program(folder: Path, number: int) -> Path:
    path = folder / "rerun"
    told = str(folder / "told")
    path.write_text(PROGRAM.format(python=sys.executable, number=number, told=told))
    path.chmod(0o755)
    return path


def test_it_waits_until_all_are_loaded_and_then_shows_the_one(tmp_path: Path) -> None:
    with ViewerControl(program(tmp_path, 4), 1, lambda: True) as control:
        control.connect()
        control.show("id-1", of=4)
    told = json.loads((tmp_path / "told").read_text())
    assert told == [4, "rerun_set_location", {"location": "at-1"}]


def test_one_that_cannot_be_loaded_is_not_waited_for_long(tmp_path: Path) -> None:
    with ViewerControl(program(tmp_path, 3), 1, lambda: True) as control:
        control.connect()
        control.show("id-0", of=4)
    assert json.loads((tmp_path / "told").read_text())[1:] == ["rerun_set_location", {"location": "at-0"}]


def test_one_that_is_not_there_is_said(tmp_path: Path) -> None:
    with ViewerControl(program(tmp_path, 2), 1, lambda: True) as control:
        control.connect()
        with pytest.raises(RecordingError, match="did not load"):
            control.show("id-9", of=2)


def test_a_viewer_that_was_closed_ends_the_waiting(tmp_path: Path) -> None:
    with (
        ViewerControl(program(tmp_path, 2), 1, lambda: False) as control,
        pytest.raises(RecordingError, match="closed"),
    ):
        control.connect()


def test_a_control_program_that_ends_is_said(tmp_path: Path) -> None:
    path = tmp_path / "rerun"
    path.write_text("#!/bin/sh\nread line\n")
    path.chmod(0o755)
    with (
        ViewerControl(path, 1, lambda: True) as control,
        pytest.raises((RecordingError, OSError)),
    ):
        control.connect()
