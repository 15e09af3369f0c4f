"""The process between a walk and its live viewer."""

import io
import pickle
import subprocess
import sys

import numpy as np
import pytest

from hexctl.control.log import COLUMN_NAMES, TickLog
from hexctl.recording import live_feed
from hexctl.recording.live import rows_of
from hexctl.runs.run import run


def test_what_is_sent_arrives_up_to_where_it_was_cut_off() -> None:
    sent = [{"rows": {"time_s": np.arange(3.0)}}, {"title": "walk"}]
    stream = b"".join(pickle.dumps(message, protocol=5) for message in sent)
    for missing in (0, 1, 20):
        arrived = list(live_feed.messages(io.BytesIO(stream[: len(stream) - missing])))
        assert len(arrived) == (2 if missing == 0 else 1)
        np.testing.assert_array_equal(arrived[0]["rows"]["time_s"], np.arange(3.0))


def test_rows_that_cross_the_pipe_are_the_rows_of_the_log() -> None:
    log = run(gait="tripod", duration_s=3.5, failure="2:limp@2.5", policy="glide", record=False).log
    other = TickLog()
    for start in range(0, len(log), 7):
        sent = pickle.dumps(rows_of(log, start, min(start + 7, len(log))))
        live_feed.append(other, pickle.loads(sent))  # noqa: S301  our own
    assert len(other) == len(log)
    assert (other.walked_ticks, other.walk_from) == (log.walked_ticks, log.walk_from)
    assert [text for _, text in log.notes if text.startswith("noticed: leg 2")]
    assert other.notes == log.notes
    assert other.leg_changes == log.leg_changes
    for name in COLUMN_NAMES:
        np.testing.assert_array_equal(other[name], log[name])


@pytest.mark.slow
def test_a_feeder_without_a_viewer_ends_by_itself() -> None:
    command = [sys.executable, "-c", SHORT_PATIENCE]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (1, b"")


SHORT_PATIENCE = """
from hexctl.recording import live_feed
live_feed.VIEWER_TIMEOUT_S = 0.3
live_feed.main("9")
"""
