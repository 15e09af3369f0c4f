"""Recordings to export: where those of a session lie, and what they are called."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.adapt.sessions.store import SessionStore
from hexctl.errors import InputError
from hexctl.export.recordings import recordings_to_export, title_of
from hexctl.recording.recorded_trial import RecordedTrial
from tests.adapt.walking import SPEC, record


def test_recordings_of_a_session_are_those_in_its_folder_wherever_they_were_written(tmp_path: Path) -> None:
    old = tmp_path / "old" / "trial-001.rrd"
    old.parent.mkdir()
    old.write_bytes(b"of another copy")
    store = SessionStore(tmp_path / "runs")
    session = store.create(SPEC)
    store.add(session, replace(record(1), recording=str(old)), {})
    store.add(session, replace(record(2), recording="runs/before/trial-002.rrd"), {})
    with pytest.raises(InputError, match="has no recordings to export"):
        recordings_to_export([session.name], tmp_path / "runs")
    folder = tmp_path / "runs" / session.name
    (folder / "trial-002.rrd").write_bytes(b"")
    found = recordings_to_export([session.name], tmp_path / "runs")
    assert found.paths == (folder / "trial-001.rrd", folder / "trial-002.rrd")


def test_a_title_names_all_legs_that_the_walk_was_told_of(walk: RecordedTrial) -> None:
    assert title_of(walk) == "phantomx tripod, leg 5 locked"
    told = walk.properties | {"further_failures": json.dumps({"2": "limp", "4": "missing"})}
    assert (
        title_of(replace(walk, properties=told)) == "phantomx tripod, leg 5 locked, leg 2 limp, leg 4 missing"
    )
    assert title_of(replace(walk, properties={"title": "phantomx tripod"})) == "phantomx tripod"
    assert title_of(replace(walk, properties={})) == "phantomx"
