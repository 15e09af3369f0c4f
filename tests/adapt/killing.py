"""A session in a process of its own, to be killed."""

import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from hexctl.adapt.optimizer import Optimizer, Trim
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.trim import TrimSearch
from hexctl.adapt.runner import TrialRequest, WalkedTrial, WalkTrial
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.adapt.sessions.walk_records import TrialRecord
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.trial_loop import AdaptLoop
from tests.adapt.priors import MadeUpModel, made_up_bayes, standing_samples
from tests.adapt.walking import SPEC, Landscape, arc_of

#: Long enough that a kill falls anywhere in a trial, its writing and its telling.
TRIAL_S = 0.002


def optimizer_of(spec: SessionSpec) -> Optimizer:
    """The optimizer that `hexctl adapt` makes for a spec; `bayes` with a made-up prior."""
    if spec.optimizer == "trim":
        return TrimSearch(GaitSpace((spec.broken.leg,)), spec.seed)
    if spec.optimizer == "bayes":
        samples = standing_samples(MadeUpModel(), 12)
        return made_up_bayes(samples, target_m=1e-6, sag_rad=np.array(spec.sag_rad))
    inner = make_optimizer(spec.optimizer, GaitSpace((spec.broken.leg,)), spec.seed)
    return Deduplication(inner, spec.seed, paper_count=spec.count_repeats)


class Drifting:
    """Walks that curve, each with noise of its own, less by their trim."""

    def __call__(self, request: TrialRequest) -> WalkedTrial:
        trim = request.trim or Trim()
        drift = Trim(0.03 + 0.01 * math.sin(1.7 * request.index), 0.02)
        return WalkedTrial(result=arc_of(drift, trim, gain=0.8))


def landscape_of(session: Session) -> WalkTrial:
    """Made-up walks of a session."""
    return Drifting() if session.spec.optimizer == "trim" else Landscape()


class Slow:
    """Walks that take a moment."""

    def __init__(self, walk: WalkTrial) -> None:
        self._walk = walk

    def __call__(self, request: TrialRequest) -> WalkedTrial:
        time.sleep(TRIAL_S)
        return self._walk(request)


def main(say: Callable[[str], None], folder: str, optimizer: str, name: str | None = None) -> None:
    """Run a session, or continue one, and say when it begins to walk and after each trial."""
    store = SessionStore(Path(folder))
    with ExitStack() as stack:
        if name is None:
            session = store.create(SPECS_TO_KILL[optimizer], stack)
        else:
            stack.enter_context(store.held(name))
            session = load_session(name, store.folder)
        say("walking")
        search = optimizer_of(session.spec)

        def stored(_: Session, walk: Walk) -> None:
            if isinstance(walk, TrialRecord):
                say("trial")

        AdaptLoop(session, store, search, Slow(landscape_of(session)), on_stored=stored).run()


SPECS_TO_KILL = {
    "dps": replace(SPEC, optimizer="dps", budget=100),
    "trim": replace(SPEC, optimizer="trim", budget=60, target_m=1e-9),
    "bayes": replace(SPEC, optimizer="bayes", budget=60, sag_rad=MadeUpModel().sags(1, 700)[0].tolist()),
}
