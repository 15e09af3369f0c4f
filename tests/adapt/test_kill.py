"""`kill -9` at random moments: the session goes on to the same end every time."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.loop import AdaptLoop
from hexctl.adapt.store import SessionStore
from tests.adapt.killing import SPECS_TO_KILL, optimizer_of
from tests.adapt.walking import Landscape

KILLS = 20
SESSIONS = 5

#: Between two kills at most, so that all of a session's fit into its budget.
MOST_TRIALS = 12

#: A few trials: a kill falls anywhere in a walk, its writing and its telling.
WITHIN_S = 0.02


def _killed_after(trials: int, delay_s: float, *arguments: str) -> None:
    """Run the session in a process of its own and kill it some time after it told of some trials."""
    command = [sys.executable, "-m", "tests.adapt.killing", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == b"walking\n"
        for _ in range(trials):
            assert process.stdout.readline() == b"trial\n"
        time.sleep(delay_s)
        os.kill(process.pid, signal.SIGKILL)
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


@pytest.mark.parametrize("optimizer", ["dps", "bayes"])
def test_kill_9_at_twenty_random_moments_never_changes_the_result(optimizer: str, tmp_path: Path) -> None:
    spec = SPECS_TO_KILL[optimizer]
    with SessionStore(tmp_path / "whole") as store:
        whole = store.create(spec)
        AdaptLoop(whole, store, optimizer_of(spec), Landscape()).run()
    random = np.random.default_rng(11)
    cut_inside = 0
    for number in range(SESSIONS):
        folder = tmp_path / str(number)
        name: list[str] = []
        for _ in range(KILLS // SESSIONS):
            trials, delay_s = int(random.integers(MOST_TRIALS)), float(random.uniform(0.0, WITHIN_S))
            _killed_after(trials, delay_s, str(folder), optimizer, *name)
            with SessionStore(folder) as store:
                name = store.names()
                cut_inside += 0 < len(store.load(name[0]).trials) < spec.budget
        with SessionStore(folder) as store, store.held(name[0]):
            session = store.load(name[0])
            AdaptLoop(session, store, optimizer_of(spec), Landscape()).run()
            assert store.load(name[0]).trials == whole.trials
    assert cut_inside >= KILLS / 2, "most kills came while it walked"
