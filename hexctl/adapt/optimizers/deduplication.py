"""Deduplication: codes are not walked twice."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexctl.adapt.optimizer import Observation, Optimizer, Prediction, Trim
from hexctl.control.planning.top_speed import Stride
from hexctl.control.trial import Enough
from hexctl.errors import HexctlError, InputError

#: Codes without a fresh one after which a search gets help: ten generations of ten.
PATIENCE = 100


class SpaceExhaustedError(HexctlError, RuntimeError):
    """Every code has been tried; there is nothing left to ask for."""


class Deduplication(Optimizer):
    """Hands out only untried codes of another optimizer.

    1. A repeated code is answered from memory, does not count, and the search is asked again.
    2. After `patience` repeated codes in a row the search is stuck, as a converged population repeats itself.
       Then random untried codes are handed out, until the search has its own new code; it is asked before
       each.
    3. The search gets only scores of codes that it asked for, in its order: others would corrupt a
       population. The scores of random codes are remembered for later.
    4. When every code has been tried, `exhausted` is True and `ask` raises SpaceExhaustedError.

    With `paper_count` repetitions are handed out and cost an evaluation each, as in the paper's convergence
    curves. Answers from memory have no observations; all other methods pass through.
    """

    def __init__(
        self,
        inner: Optimizer,
        seed: int,
        *,
        patience: int = PATIENCE,
        paper_count: bool = False,
    ) -> None:
        super().__init__(inner.space, seed)
        # The substitutes must differ from the codes that the same seed gives the search.
        self._random = np.random.default_rng(seed).spawn(1)[0]
        self.name, self.judges_target, self.trims = inner.name, inner.judges_target, inner.trims
        self._inner = inner
        self._rules = {"patience": patience, "paper_count": paper_count}
        self._patience, self._paper_count = patience, paper_count
        self._scores: dict[int, float] = {}
        self._batch: list[int] = []  # what the search waits for
        self._stale = 0  # codes in a row that were not fresh

    @property
    def exhausted(self) -> bool:
        """True if every code has been tried and repetitions are not wanted, or the search has no more."""
        if not self._paper_count and len(self._scores) == self.space.size:
            return True
        return self._inner.exhausted

    @property
    def finished(self) -> bool:
        """As the wrapped optimizer."""
        return self._inner.finished

    @property
    def worthwhile(self) -> bool:
        """As the wrapped optimizer."""
        return self._inner.worthwhile

    def recommended(self) -> int | None:
        """As the wrapped optimizer."""
        return self._inner.recommended()

    def repeat(self, code: int, score: float, observation: Observation) -> None:
        """Pass a walk without an ask to the wrapped optimizer."""
        self._inner.repeat(code, score, observation)

    def trim(self, code: int) -> Trim | None:
        """As the wrapped optimizer."""
        return self._inner.trim(code)

    def stride(self, code: int) -> Stride | None:
        """As the wrapped optimizer."""
        return self._inner.stride(code)

    def predict(self, code: int) -> Prediction | None:
        """As the wrapped optimizer."""
        return self._inner.predict(code)

    def early_stopping(self, code: int) -> Enough | None:
        """As the wrapped optimizer."""
        return self._inner.early_stopping(code)

    def _suggest(self, count: int) -> list[int]:
        if self._paper_count:
            return self._inner.ask(count)
        if len(self._scores) == self.space.size:
            raise SpaceExhaustedError(f"{self.name}: all {self.space.size} codes have been tried")
        while True:
            batch = self._inner.ask(count)
            fresh = list(dict.fromkeys(code for code in batch if code not in self._scores))
            if fresh:
                self._batch, self._stale = batch, 0
                return fresh
            self._inner.tell(batch, [self._scores[code] for code in batch])
            self._stale += len(batch)
            if self._stale >= self._patience:
                return self._untried(count)

    def _learn_observed(
        self, codes: list[int], scores: list[float], observations: Sequence[Observation | None]
    ) -> None:
        self._scores.update(zip(codes, scores, strict=True))
        if self._paper_count:
            self._inner.tell(codes, scores, observations)
        elif self._batch:
            batch, self._batch = self._batch, []
            walked = dict(zip(codes, observations, strict=True))
            self._inner.tell(
                batch, [self._scores[code] for code in batch], [walked.get(code) for code in batch]
            )

    def _untried(self, count: int) -> list[int]:
        left = [code for code in range(1, self.space.size + 1) if code not in self._scores]
        chosen = self._random.permutation(len(left))[:count]
        return [left[index] for index in chosen]

    def _search_state(self) -> dict[str, Any]:
        return {
            "rules": dict(self._rules),
            "tried": [[code, score] for code, score in self._scores.items()],
            "batch": list(self._batch),
            "stale": self._stale,
            "inner": self._inner.state(),
        }

    def _restore_search(self, state: dict[str, Any]) -> None:
        if state["rules"] != self._rules:
            raise InputError(f"counting rule: got {state['rules']}; allowed: {self._rules}")
        self._scores = {int(code): float(score) for code, score in state["tried"]}
        self._batch = [int(code) for code in state["batch"]]
        self._stale = int(state["stale"])
        self._inner.restore(state["inner"])
