"""A session in a process of its own, for tests that kill it: `-m tests.adapt.killing FOLDER [NAME]`."""

import sys
import time
from pathlib import Path

from hexctl.adapt.catalogue import make_optimizer
from hexctl.adapt.counting import FreshCodes
from hexctl.adapt.loop import AdaptLoop
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.session import SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.store import SessionStore
from hexctl.control.result import TrialResult
from hexctl.control.trial import Enough
from hexctl.gait.encoding import Slots
from tests.adapt.walking import SPEC, Landscape

#: Long enough that a kill falls anywhere in a trial, its writing and its telling.
TRIAL_S = 0.002


def optimizer_of(spec: SessionSpec) -> Optimizer:
    """Return the optimizer that `hexctl adapt` makes for a spec."""
    inner = make_optimizer(spec.optimizer, GaitSpace((spec.failed_leg,)), spec.seed)
    return FreshCodes(inner, spec.seed, paper_count=spec.count_repeats)


class SlowLandscape(Landscape):
    """A landscape whose trials take a moment."""

    def __call__(
        self, index: int, code: int, slots: Slots, enough: Enough | None = None
    ) -> tuple[TrialResult, Path | None]:
        time.sleep(TRIAL_S)
        return super().__call__(index, code, slots, enough)


def main(folder: str, name: str | None = None) -> None:
    """Run a session, or continue one, and say when it begins to walk."""
    with SessionStore(Path(folder)) as store:
        session = store.create(SPEC_TO_KILL) if name is None else store.load(name)
        with store.held(session.name):
            sys.stdout.write("walking\n")
            sys.stdout.flush()
            AdaptLoop(session, store, optimizer_of(session.spec), SlowLandscape()).run()


SPEC_TO_KILL = SessionSpec(**{**SPEC.as_json(), "optimizer": "dps", "budget": 100})

if __name__ == "__main__":
    main(*sys.argv[1:])
