"""The process between a walk and its live viewer."""

import io
import pickle
import subprocess
import sys

import numpy as np

from hexctl.control.log import COLUMNS, TickLog
from hexctl.record import live_feed
from tests.trials import walk


def test_what_is_sent_arrives_up_to_where_it_was_cut_off() -> None:
    sent = [{"rows": {"time_s": np.arange(3.0)}}, {"title": "walk"}]
    stream = b"".join(pickle.dumps(message, protocol=5) for message in sent)
    for missing in (0, 1, 20):
        arrived = list(live_feed.messages(io.BytesIO(stream[: len(stream) - missing])))
        assert len(arrived) == (2 if missing == 0 else 1)
        np.testing.assert_array_equal(arrived[0]["rows"]["time_s"], np.arange(3.0))


def test_rows_that_cross_the_pipe_are_the_rows_of_the_log() -> None:
    log, other = walk(duration_s=1.0).log, TickLog()
    for start in range(0, len(log), 7):
        other.extend({name: log.rows(name, start, min(start + 7, len(log))) for name, _, _ in COLUMNS})
    assert len(other) == len(log)
    assert other.walked_ticks == log.walked_ticks
    for name, _, _ in COLUMNS:
        np.testing.assert_array_equal(other[name], log[name])


def test_a_feeder_without_a_viewer_ends_by_itself() -> None:
    command = [sys.executable, "-c", SHORT_PATIENCE]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (1, b"")


SHORT_PATIENCE = """
from hexctl.record import live_feed
live_feed.VIEWER_TIMEOUT_S = 0.3
live_feed.main("9")
"""
