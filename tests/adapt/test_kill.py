"""`kill -9` at random moments: the session continues to the same end every time."""

import math
import multiprocessing
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.optimizer import Trim
from hexctl.adapt.runner import TrialRequest, WalkedTrial
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.store import SessionStore, load_session, stored_names
from hexctl.adapt.sessions.walk_records import TrialRecord
from hexctl.adapt.trial_loop import AdaptLoop
from tests.adapt.priors import MadeUpModel, optimizer_of
from tests.adapt.walking import SPEC, Landscape, arc_of

pytestmark = pytest.mark.slow

SPECS_TO_KILL = {
    "dps": replace(SPEC, optimizer="dps", budget=100),
    "trim": replace(SPEC, optimizer="trim", budget=60, target_m=1e-9),
    "bayes": replace(SPEC, optimizer="bayes", budget=60, sag_rad=MadeUpModel().sags(1, 700)[0].tolist()),
}

#: Sessions of each optimizer.
SESSIONS = {"dps": 3, "bayes": 1, "trim": 1}

#: How often each session is killed.
KILLS = 4

#: Long enough that a kill falls anywhere in a trial, its writing and its telling.
TRIAL_S = 0.002

#: Between two kills at most, so that all of a session's fit into its budget.
MOST_TRIALS = 12

#: A few trials: a kill falls anywhere in a walk, its writing and its telling.
WITHIN_S = 0.02

#: Starts processes that have everything imported already.
SERVER = multiprocessing.get_context("forkserver")


class Walks:
    """Walks of a session: gaits of a landscape, or curves with noise of their own less their trim."""

    def __init__(self, session: Session, delay_s: float = 0.0) -> None:
        self._trims, self._delay_s = session.spec.optimizer == "trim", delay_s
        self._landscape = Landscape()

    def __call__(self, request: TrialRequest) -> WalkedTrial:
        time.sleep(self._delay_s)
        if not self._trims:
            return self._landscape(request)
        drift = Trim(0.03 + 0.01 * math.sin(1.7 * request.index), 0.02)
        return WalkedTrial(result=arc_of(drift, request.trim or Trim(), gain=0.8))


def main(say: Callable[[str], None], folder: str, optimizer: str, name: str | None = None) -> None:
    """Run a session, or continue one, and say when it begins to walk and after each trial."""
    store = SessionStore(Path(folder))
    with ExitStack() as stack:
        if name is None:
            session = store.create(SPECS_TO_KILL[optimizer], stack)
        else:
            stack.enter_context(store.locked(name))
            session = load_session(name, store.folder)
        say("walking")

        def stored(_: Session, walk: Walk) -> None:
            if isinstance(walk, TrialRecord):
                say("trial")

        walks = Walks(session, TRIAL_S)
        AdaptLoop(session, store, optimizer_of(session.spec), walks, on_stored=stored).run()


def _killed_after(trials: int, delay_s: float, *arguments: str) -> None:
    """Run the session in a process of its own and kill it some time after it told of some trials."""
    here, there = SERVER.Pipe(duplex=False)
    process = SERVER.Process(target=main, args=(there.send, *arguments))
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
    AdaptLoop(whole, store, optimizer_of(spec), Walks(whole)).run()
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
        with store.locked(name[0]):
            session = load_session(name[0], store.folder)
            AdaptLoop(session, store, optimizer_of(spec), Walks(session)).run()
            assert load_session(name[0], store.folder).trials == whole.trials
    assert cut_inside >= SESSIONS[optimizer] * KILLS / 2, "most kills came while it walked"
