"""Tests for every `Optimizer`."""

import itertools
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.optimizer import Optimizer, OptimizerMisuseError
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError

ONE_FAILED, TWO_FAILED, THREE_FAILED = GaitSpace((5,)), GaitSpace((2, 5)), GaitSpace((1, 3, 5))

#: The score of a gait code.
Landscape = Callable[[int], float]

#: Makes a fresh optimizer from a space and a seed.
Make = Callable[[GaitSpace, int], Optimizer]

BATCHES = (1, 3, 10, 64)


def slope(code: int) -> float:
    """A smooth landscape whose best code is 77."""
    return abs(code - 77.3)


def search(
    optimizer: Optimizer, trials: int, *, batch: int = 1, landscape: Landscape = slope, scored: bool = True
) -> list[int]:
    """Ask for `trials` codes in batches and report their scores; return the codes.

    Ends early when the optimizer is exhausted. With `scored` False the last batch is not reported.
    """
    codes: list[int] = []
    while len(codes) < trials and not optimizer.exhausted:
        asked = optimizer.ask(min(batch, trials - len(codes)))
        codes += asked
        if scored or len(codes) < trials:
            optimizer.tell(asked, [landscape(code) for code in asked])
    return codes


def travelled(state: dict[str, Any]) -> dict[str, Any]:
    """A state after a round trip through strict JSON."""
    text = json.dumps(state, allow_nan=False)
    loaded: dict[str, Any] = json.loads(text)
    assert loaded == state, "not made of JSON values alone"
    return loaded


#: Invalid arguments of `tell` from good ones: codes and scores of one `ask(3)`.
WRONG_TELLS: dict[str, Callable[[list[Any], list[Any]], tuple[list[Any], list[Any]]]] = {
    "a code left out": lambda codes, scores: (codes[:-1], scores[:-1]),
    "a score left out": lambda codes, scores: (codes, scores[:-1]),
    "a score too many": lambda codes, scores: (codes, [*scores, 1.0]),
    "a code too many": lambda codes, scores: ([*codes, 5], [*scores, 1.0]),
    "another code": lambda codes, scores: ([codes[0] % 120 + 1, *codes[1:]], scores),
    "no code": lambda codes, scores: ([0, *codes[1:]], scores),
    "nothing": lambda *_: ([], []),
    "nan": lambda codes, scores: (codes, [math.nan, *scores[1:]]),
    "inf": lambda codes, scores: (codes, [*scores[:-1], math.inf]),
    "-inf": lambda codes, scores: (codes, [-math.inf, *scores[1:]]),
    "none": lambda codes, scores: (codes, [None, *scores[1:]]),
    "text": lambda codes, scores: (codes, ["0.1", *scores[1:]]),
}


class OptimizerConformance:
    """The suite: inherit it, name the class `Test...` and define how to make an optimizer.

    Attributes:
        spaces: spaces of gaits that the optimizer can search; the first is one failed leg's.
        seeded: False for an optimizer without random numbers.
    """

    spaces: tuple[GaitSpace, ...] = (ONE_FAILED, TWO_FAILED, THREE_FAILED)
    seeded = True

    @pytest.fixture
    def make(self) -> Make:
        """Makes a fresh optimizer from a space and a seed."""
        raise NotImplementedError("make: a fixture that returns a function of a GaitSpace and a seed")

    @pytest.fixture
    def optimizer(self, make: Make) -> Optimizer:
        """A fresh optimizer for one failed leg."""
        return make(ONE_FAILED, 1)

    def test_codes_are_in_the_space_and_no_more_than_asked_for(self, make: Make) -> None:
        """`ask(n)` gives one to n codes, each a whole number in the space."""
        for space, batch in itertools.product(self.spaces, BATCHES):
            self.check_asks(make(space, 3), space, batch)

    def check_asks(self, optimizer: Optimizer, space: GaitSpace, batch: int) -> None:
        """Check the codes of batches."""
        asked = 0
        while asked < 150 and not optimizer.exhausted:
            codes = optimizer.ask(batch)
            asked += len(codes)
            assert 1 <= len(codes) <= batch
            assert all(type(code) is int and 1 <= code <= space.size for code in codes)
            optimizer.tell(codes, [slope(code) for code in codes])

    def test_the_same_seed_gives_the_same_search(self, make: Make) -> None:
        """Two searches with one seed and the same scores ask for the same codes."""
        assert search(make(ONE_FAILED, 7), 60) == search(make(ONE_FAILED, 7), 60)

    def test_another_seed_gives_another_search(self, make: Make) -> None:
        """Another seed gives other codes, unless `seeded` is False."""
        same = search(make(ONE_FAILED, 7), 20) == search(make(ONE_FAILED, 8), 20)
        assert same != self.seeded

    def test_a_negative_seed_is_refused(self, make: Make) -> None:
        """A negative seed is refused with InputError."""
        with pytest.raises(InputError, match="seed: got -1"):
            make(ONE_FAILED, -1)

    def test_asking_for_nothing_is_refused(self, optimizer: Optimizer) -> None:
        """`ask(0)` and `ask(-1)` are refused with InputError, and the next `ask` works."""
        for count in (0, -1):
            with pytest.raises(InputError, match=f"got a request for {count} codes; allowed: 1 or more"):
                optimizer.ask(count)
        assert optimizer.ask()

    def test_ask_after_ask_is_refused_and_changes_nothing(self, optimizer: Optimizer) -> None:
        """A second `ask` before a `tell` is refused with OptimizerMisuseError."""
        codes = optimizer.ask(3)
        before = travelled(optimizer.state())
        with pytest.raises(OptimizerMisuseError, match="ask after ask"):
            optimizer.ask()
        assert optimizer.state() == before
        optimizer.tell(codes, [1.0] * len(codes))

    def test_tell_without_ask_is_refused_and_changes_nothing(self, optimizer: Optimizer) -> None:
        """A `tell` that no `ask` came before is refused with OptimizerMisuseError."""
        before = travelled(optimizer.state())
        with pytest.raises(OptimizerMisuseError, match="tell without ask"):
            optimizer.tell([1], [1.0])
        assert optimizer.state() == before
        codes = optimizer.ask()
        optimizer.tell(codes, [1.0])
        with pytest.raises(OptimizerMisuseError, match="tell without ask"):
            optimizer.tell(codes, [1.0])

    def test_a_wrong_tell_is_refused_and_nothing_is_taken_over(self, optimizer: Optimizer) -> None:
        """A `tell` of other codes, or of non-finite scores, changes nothing."""
        search(optimizer, 13)
        codes = optimizer.ask(3)
        scores = [slope(code) for code in codes]
        before = travelled(optimizer.state())
        for name, spoil in WRONG_TELLS.items():
            with pytest.raises(InputError, match=r"got .*; allowed: "):
                optimizer.tell(*spoil(list(codes), list(scores)))
            assert optimizer.state() == before, name
        optimizer.tell(codes, scores)

    def test_what_the_caller_does_to_its_lists_has_no_effect(self, make: Make) -> None:
        """The caller may save at any time, and change returned lists and states; `tell` changes no list."""
        undisturbed, disturbed = make(ONE_FAILED, 2), make(ONE_FAILED, 2)
        for _ in range(8):
            codes = undisturbed.ask(4)
            undisturbed.tell(codes, [slope(code) for code in codes])
            spoilt = disturbed.ask(4)
            disturbed.state()["asked"].clear()
            disturbed.state()["search"].clear()
            spoilt.reverse()
            scored, scores = list(codes), [slope(code) for code in codes]
            disturbed.tell(scored, scores)
            assert (scored, scores) == (codes, [slope(code) for code in codes])
            scored.clear()
            scores.clear()
        assert disturbed.state() == undisturbed.state()

    def test_numpy_arrays_are_taken_like_lists(self, make: Make) -> None:
        """`tell` takes numpy arrays, and the state stays plain JSON."""
        plain, arrays = make(ONE_FAILED, 2), make(ONE_FAILED, 2)
        for _ in range(8):
            codes = plain.ask(4)
            plain.tell(codes, [slope(code) for code in codes])
            codes = arrays.ask(4)
            arrays.tell(np.array(codes), np.array([slope(code) for code in codes]))  # type: ignore[arg-type]
        assert travelled(arrays.state()) == plain.state()

    def test_a_restored_search_continues_exactly(self, make: Make) -> None:
        """A search restored from its state, through JSON, asks for the same codes as the original."""
        for trials, batch in ((0, 1), (1, 1), (7, 1), (10, 1), (33, 1), (24, 3), (38, 10)):
            for scored in (True, False):
                self.check_restores(make, trials, batch, scored=scored or trials == 0)

    def check_restores(self, make: Make, trials: int, batch: int, *, scored: bool) -> None:
        """Check that a search saved after some trials, the last ones reported or not, continues exactly."""
        original, restored = make(ONE_FAILED, 5), make(ONE_FAILED, 99)
        search(original, trials, batch=batch, scored=scored)
        search(restored, 17)
        saved = travelled(original.state())
        restored.restore(saved)
        if saved["asked"]:
            scores = [slope(code) for code in saved["asked"]]
            original.tell(saved["asked"], scores)
            restored.tell(saved["asked"], scores)
        assert search(restored, 60) == search(original, 60), f"after {trials} trials by {batch}"
        assert restored.state() == original.state()

    def test_the_state_of_another_search_is_refused(self, make: Make, optimizer: Optimizer) -> None:
        """The state of another space or optimizer is refused with InputError and not taken over."""
        before = travelled(optimizer.state())
        others = [make(space, 1).state() for space in (GaitSpace((2,)), *self.spaces[1:2])]
        for state in (*others, before | {"name": "unknown"}):
            with pytest.raises(InputError, match="optimizer state: got"):
                optimizer.restore(state)
            assert optimizer.state() == before

    def test_a_damaged_state_is_refused_and_nothing_is_taken_over(
        self, make: Make, optimizer: Optimizer
    ) -> None:
        """A state that lacks a part is refused with InputError and not taken over."""
        search(optimizer, 13)
        before = travelled(optimizer.state())
        other = make(ONE_FAILED, 9)
        search(other, 25)
        for part in ("random", "asked", "search"):
            saved = travelled(other.state())
            del saved[part]
            with pytest.raises(InputError, match=r"optimizer state of .*damaged"):
                optimizer.restore(saved)
            assert optimizer.state() == before, part

    def test_500_equal_scores_do_no_harm(self, make: Make) -> None:
        """500 equal scores neither raise nor hang; an exhausted search has asked for every code."""
        for space in self.spaces:
            optimizer = make(space, 6)
            codes = search(optimizer, 500, landscape=lambda _: 1e9)
            every = list(range(1, space.size + 1))
            assert len(codes) == 500 or (optimizer.exhausted and sorted(codes) == every)

    def test_a_landscape_of_failures_with_one_good_code_does_no_harm(self, make: Make) -> None:
        """A landscape of invalid trials with one valid code neither raises nor hangs."""
        optimizer = make(ONE_FAILED, 6)
        codes = search(optimizer, 300, batch=10, landscape=lambda code: 0.01 if code == 60 else 1e9)
        assert set(codes) <= set(range(1, 121))

    def test_another_score_for_the_same_code_is_taken(self, make: Make) -> None:
        """A code may get another score each time: trials on a robot are noisy."""
        optimizer, random = make(ONE_FAILED, 6), np.random.default_rng(0)
        search(optimizer, 200, landscape=lambda code: slope(code) + random.normal())
        travelled(optimizer.state())
