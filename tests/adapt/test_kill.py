"""`kill -9` at random moments: the session continues to the same end every time."""

import multiprocessing
import time
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.sessions.store import SessionStore, load_session, stored_names
from hexctl.adapt.trial_loop import AdaptLoop
from tests.adapt import killing
from tests.adapt.killing import SPECS_TO_KILL, landscape_of, optimizer_of

pytestmark = pytest.mark.slow


#: Sessions of each optimizer, and how often each session is killed.
SESSIONS = {"dps": 3, "bayes": 1, "trim": 1}

KILLS = 4

#: Between two kills at most, so that all of a session's fit into its budget.
MOST_TRIALS = 12

#: A few trials: a kill falls anywhere in a walk, its writing and its telling.
WITHIN_S = 0.02

#: Starts processes that have everything imported already.
SERVER = multiprocessing.get_context("forkserver")


def _killed_after(trials: int, delay_s: float, *arguments: str) -> None:
    """Run the session in a process of its own and kill it some time after it told of some trials."""
    here, there = SERVER.Pipe(duplex=False)
    process = SERVER.Process(target=killing.main, args=(there.send, *arguments))
    process.start()
    there.close()
    try:
        assert here.recv() == "walking"
        for _ in range(trials):
            assert here.recv() == "trial"
        time.sleep(delay_s)
    finally:
        process.kill()
        process.join()
        here.close()


@pytest.mark.parametrize("optimizer", SESSIONS)
def test_kill_9_at_random_moments_never_changes_the_result(optimizer: str, tmp_path: Path) -> None:
    spec = SPECS_TO_KILL[optimizer]
    store = SessionStore(tmp_path / "whole")
    whole = store.create(spec)
    AdaptLoop(whole, store, optimizer_of(spec), landscape_of(whole)).run()
    random = np.random.default_rng(11)
    cut_inside = 0
    for number in range(SESSIONS[optimizer]):
        folder = tmp_path / str(number)
        name: list[str] = []
        for _ in range(KILLS):
            trials, delay_s = int(random.integers(MOST_TRIALS)), float(random.uniform(0.0, WITHIN_S))
            _killed_after(trials, delay_s, str(folder), optimizer, *name)
            store = SessionStore(folder)
            name = stored_names(store.folder)
            cut_inside += 0 < len(load_session(name[0], store.folder).trials) < spec.budget
        store = SessionStore(folder)
        with store.held(name[0]):
            session = load_session(name[0], store.folder)
            AdaptLoop(session, store, optimizer_of(spec), landscape_of(session)).run()
            assert load_session(name[0], store.folder).trials == whole.trials
    assert cut_inside >= SESSIONS[optimizer] * KILLS / 2, "most kills came while it walked"
