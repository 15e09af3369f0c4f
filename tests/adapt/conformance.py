"""What every Optimizer must do, as tests. Inherit the class, name it `Test...` and say how to make one."""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.optimizer import Optimizer, OptimizerMisuseError
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError
from tests.adapt.searching import ONE_FAILED, THREE_FAILED, TWO_FAILED, search, slope

Make = Callable[[GaitSpace, int], Optimizer]

BATCHES = [1, 3, 10, 64]


def travelled(state: dict[str, Any]) -> dict[str, Any]:
    """Return a state after its way through strict JSON."""
    text = json.dumps(state, allow_nan=False)
    loaded: dict[str, Any] = json.loads(text)
    assert loaded == state, "not made of JSON values alone"
    return loaded


class OptimizerConformance:
    """The suite."""

    @pytest.fixture
    def make(self) -> Make:
        """Return what makes a fresh optimizer from a space and a seed."""
        raise NotImplementedError

    @pytest.fixture
    def optimizer(self, make: Make) -> Optimizer:
        return make(ONE_FAILED, 1)

    @pytest.mark.parametrize("space", [ONE_FAILED, TWO_FAILED, THREE_FAILED], ids=lambda space: space.size)
    @pytest.mark.parametrize("batch", BATCHES)
    def test_codes_are_in_the_space_and_no_more_than_asked_for(
        self, make: Make, space: GaitSpace, batch: int
    ) -> None:
        optimizer = make(space, 3)
        asked = 0
        while asked < 150 and not optimizer.exhausted:
            codes = optimizer.ask(batch)
            asked += len(codes)
            assert 1 <= len(codes) <= batch
            assert all(type(code) is int and 1 <= code <= space.size for code in codes)
            optimizer.tell(codes, [slope(code) for code in codes])

    def test_the_same_seed_gives_the_same_search(self, make: Make) -> None:
        assert search(make(ONE_FAILED, 7), 60) == search(make(ONE_FAILED, 7), 60)

    def test_another_seed_gives_another_search(self, make: Make) -> None:
        first = make(ONE_FAILED, 7)
        if first.name != "exhaustive":
            assert search(first, 20) != search(make(ONE_FAILED, 8), 20)

    def test_a_negative_seed_is_refused(self, make: Make) -> None:
        with pytest.raises(InputError, match="seed: got -1"):
            make(ONE_FAILED, -1)

    @pytest.mark.parametrize("count", [0, -1])
    def test_asking_for_nothing_is_refused(self, optimizer: Optimizer, count: int) -> None:
        with pytest.raises(InputError, match=f"got a request for {count} codes; allowed: 1 or more"):
            optimizer.ask(count)
        assert optimizer.ask()

    def test_ask_after_ask_is_refused_and_changes_nothing(self, optimizer: Optimizer) -> None:
        codes = optimizer.ask(3)
        before = travelled(optimizer.state())
        with pytest.raises(OptimizerMisuseError, match="ask after ask"):
            optimizer.ask()
        assert optimizer.state() == before
        optimizer.tell(codes, [1.0] * len(codes))

    def test_tell_without_ask_is_refused_and_changes_nothing(self, optimizer: Optimizer) -> None:
        before = travelled(optimizer.state())
        with pytest.raises(OptimizerMisuseError, match="tell without ask"):
            optimizer.tell([1], [1.0])
        assert optimizer.state() == before
        codes = optimizer.ask()
        optimizer.tell(codes, [1.0])
        with pytest.raises(OptimizerMisuseError, match="tell without ask"):
            optimizer.tell(codes, [1.0])

    @pytest.mark.parametrize(
        "spoil",
        [
            lambda codes, scores: (codes[:-1], scores[:-1]),
            lambda codes, scores: (codes, scores[:-1]),
            lambda codes, scores: (codes, [*scores, 1.0]),
            lambda codes, scores: ([*codes, 5], [*scores, 1.0]),
            lambda codes, scores: ([codes[0] % 120 + 1, *codes[1:]], scores),
            lambda codes, scores: ([0, *codes[1:]], scores),
            lambda *_: ([], []),
            lambda codes, scores: (codes, [math.nan, *scores[1:]]),
            lambda codes, scores: (codes, [*scores[:-1], math.inf]),
            lambda codes, scores: (codes, [-math.inf, *scores[1:]]),
            lambda codes, scores: (codes, [None, *scores[1:]]),
            lambda codes, scores: (codes, ["0.1", *scores[1:]]),
        ],
        ids=[
            "a code left out",
            "a score left out",
            "a score too many",
            "a code too many",
            "another code",
            "no code",
            "nothing",
            "nan",
            "inf",
            "-inf",
            "none",
            "text",
        ],
    )
    def test_a_wrong_tell_is_refused_and_nothing_is_taken_over(
        self, optimizer: Optimizer, spoil: Callable[[Any, Any], tuple[Any, Any]]
    ) -> None:
        search(optimizer, 13)
        codes = optimizer.ask(3)
        before = travelled(optimizer.state())
        with pytest.raises(InputError, match=r"got .*; allowed: "):
            optimizer.tell(*spoil(codes, [slope(code) for code in codes]))
        assert optimizer.state() == before
        optimizer.tell(codes, [slope(code) for code in codes])

    def test_the_lists_of_the_caller_stay_as_they_are(self, optimizer: Optimizer) -> None:
        for _ in range(6):
            codes = optimizer.ask(5)
            scores = [slope(code) for code in codes]
            kept_codes, kept_scores = list(codes), list(scores)
            optimizer.tell(codes, scores)
            assert (codes, scores) == (kept_codes, kept_scores)

    def test_what_the_caller_does_to_its_lists_has_no_effect(self, make: Make) -> None:
        undisturbed, disturbed = make(ONE_FAILED, 2), make(ONE_FAILED, 2)
        for _ in range(8):
            codes = undisturbed.ask(4)
            undisturbed.tell(codes, [slope(code) for code in codes])
            spoilt = disturbed.ask(4)
            disturbed.state()["asked"].clear()
            disturbed.state()["search"].clear()
            spoilt.reverse()
            told, scores = list(codes), [slope(code) for code in codes]
            disturbed.tell(told, scores)
            told.clear()
            scores.clear()
        assert disturbed.state() == undisturbed.state()

    def test_numpy_arrays_are_taken_like_lists(self, make: Make) -> None:
        plain, arrays = make(ONE_FAILED, 2), make(ONE_FAILED, 2)
        for _ in range(8):
            codes = plain.ask(4)
            plain.tell(codes, [slope(code) for code in codes])
            codes = arrays.ask(4)
            arrays.tell(np.array(codes), np.array([slope(code) for code in codes]))  # type: ignore[arg-type]
        assert travelled(arrays.state()) == plain.state()

    @pytest.mark.parametrize("told", [True, False], ids=["told", "in the air"])
    @pytest.mark.parametrize(
        ("trials", "batch"), [(0, 1), (1, 1), (7, 1), (10, 1), (33, 1), (24, 3), (38, 10)]
    )
    def test_a_restored_search_goes_on_exactly(self, make: Make, trials: int, batch: int, told: bool) -> None:
        original, restored = make(ONE_FAILED, 5), make(ONE_FAILED, 99)
        search(original, trials, batch=batch, told=told or trials == 0)
        search(restored, 17)
        saved = travelled(original.state())
        restored.restore(saved)
        if saved["asked"]:
            scores = [slope(code) for code in saved["asked"]]
            original.tell(saved["asked"], scores)
            restored.tell(saved["asked"], scores)
        assert search(restored, 60) == search(original, 60)
        assert restored.state() == original.state()

    def test_saving_does_not_change_the_search(self, make: Make) -> None:
        quiet, saved = make(ONE_FAILED, 4), make(ONE_FAILED, 4)
        codes = search(quiet, 40)
        for code in codes:
            saved.state()
            assert saved.ask() == [code]
            saved.state()
            saved.tell([code], [slope(code)])

    @pytest.mark.parametrize("other", [TWO_FAILED, GaitSpace((2,))], ids=["other size", "other leg"])
    def test_the_state_of_another_space_is_refused(
        self, make: Make, optimizer: Optimizer, other: GaitSpace
    ) -> None:
        before = travelled(optimizer.state())
        with pytest.raises(InputError, match="optimizer state: got"):
            optimizer.restore(make(other, 1).state())
        assert optimizer.state() == before

    def test_the_state_of_another_optimizer_is_refused(self, optimizer: Optimizer) -> None:
        before = travelled(optimizer.state())
        with pytest.raises(InputError, match="optimizer state: got"):
            optimizer.restore(before | {"name": "nobody"})
        assert optimizer.state() == before

    @pytest.mark.parametrize("part", ["random", "asked", "search"])
    def test_a_damaged_state_is_refused_and_nothing_is_taken_over(
        self, make: Make, optimizer: Optimizer, part: str
    ) -> None:
        search(optimizer, 13)
        before = travelled(optimizer.state())
        other = make(ONE_FAILED, 9)
        search(other, 25)
        saved = travelled(other.state())
        del saved[part]
        with pytest.raises(InputError, match=r"optimizer state of .*damaged"):
            optimizer.restore(saved)
        assert optimizer.state() == before

    @pytest.mark.parametrize("space", [ONE_FAILED, TWO_FAILED, THREE_FAILED], ids=lambda space: space.size)
    def test_500_equal_scores_do_no_harm(self, make: Make, space: GaitSpace) -> None:
        optimizer = make(space, 6)
        codes = search(optimizer, 500, landscape=lambda _: 1e9)
        assert len(codes) == 500 or (optimizer.exhausted and sorted(codes) == list(range(1, space.size + 1)))

    def test_a_landscape_of_failures_with_one_good_code_does_no_harm(self, make: Make) -> None:
        optimizer = make(ONE_FAILED, 6)
        codes = search(optimizer, 300, batch=10, landscape=lambda code: 0.01 if code == 60 else 1e9)
        assert set(codes) <= set(range(1, 121))

    def test_another_score_for_the_same_code_is_taken(self, make: Make) -> None:
        optimizer, random = make(ONE_FAILED, 6), np.random.default_rng(0)
        search(optimizer, 200, landscape=lambda code: slope(code) + random.normal())
        travelled(optimizer.state())
