"""Recordings to export: what they are called."""

import json
from dataclasses import replace

from hexctl.export.recordings import title_of
from hexctl.record.recorded_trial import RecordedTrial


def test_a_title_names_all_legs_that_the_walk_was_told_of(walk: RecordedTrial) -> None:
    assert title_of(walk) == "phantomx demo, leg 5 locked"
    told = walk.properties | {"further_failures": json.dumps({"2": "limp", "4": "missing"})}
    assert (
        title_of(replace(walk, properties=told)) == "phantomx demo, leg 5 locked, leg 2 limp, leg 4 missing"
    )
    assert title_of(replace(walk, properties={"title": "phantomx tripod"})) == "phantomx tripod"
    assert title_of(replace(walk, properties={})) == "phantomx"
