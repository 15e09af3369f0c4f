import pickle

import numpy as np
import pytest

from hexctl.adapt.objective import INVALID_SCORE, score_of
from hexctl.control.batch import run_sim_trial
from hexctl.study.chunk import Chunk, chunks_of, simulate_chunk
from hexctl.study.landscape import NUMBERS, empty_landscape, with_rows
from tests.study.landscapes import made_up, same, spec, spread_out

CODES = (3, 40, 77, 120)


@pytest.fixture(scope="module")
def one() -> Chunk:
    return Chunk(spec=spec(5, "none", 3.0, CODES), codes=CODES)


def test_rows_are_those_of_the_trials_alone(one: Chunk) -> None:
    rows = simulate_chunk(one).rows
    for row, code in enumerate(CODES):
        alone = run_sim_trial(one.spec.trial(code))
        assert alone.deviation is not None
        assert rows.status[row] == alone.status
        expected = [
            alone.deviation.signed,
            alone.deviation.mean,
            alone.deviation.max,
            alone.distance_m,
            alone.yaw_change_rad,
            alone.turned_rad,
        ]
        assert rows.numbers[row].tolist() == expected
        assert rows.paths_m[row].tolist() == alone.path_m[9::10].astype(np.float32).tolist()
        assert rows.paths_m[row, -1, 1] == np.float32(alone.deviation.signed)


@pytest.mark.parametrize("self_rotation", ["none", "rear"])
def test_cutting_into_chunks_changes_nothing(self_rotation: str) -> None:
    landscape = empty_landscape(spec(2, self_rotation, 1.0, CODES))
    (whole,) = [simulate_chunk(chunk) for chunk in chunks_of(landscape, 4)]
    for size in (1, 3):
        cut = landscape
        for chunk in chunks_of(landscape, size):
            cut = with_rows(cut, simulate_chunk(chunk).rows)
        assert same(cut, whole.rows)


def test_a_chunk_travels_as_a_pickle(one: Chunk) -> None:
    sent = pickle.loads(pickle.dumps(one))  # noqa: S301
    assert sent.spec.fingerprint == one.spec.fingerprint
    assert same(simulate_chunk(sent).rows, simulate_chunk(one).rows)


def test_scores_are_those_that_an_optimizer_is_told() -> None:
    asked = spec(2, "none", 6.0, CODES)
    landscape = with_rows(empty_landscape(asked), simulate_chunk(Chunk(spec=asked, codes=CODES)).rows)
    results = [run_sim_trial(asked.trial(code)) for code in CODES]
    assert landscape.scores.tolist() == [score_of(result, "final") for result in results]


def test_invalid_gaits_are_behind_all_others_and_never_the_best() -> None:
    landscape = made_up(5, "rear", np.linspace(0, 1, 120), invalid=[1, 2])
    assert landscape.scores[:2].tolist() == [INVALID_SCORE] * 2
    assert landscape.best_m == pytest.approx(2 / 119)
    assert np.isnan(made_up(5, "rear", spread_out(1.0), invalid=range(1, 121)).best_m)


def test_what_is_missing_can_be_told() -> None:
    landscape = empty_landscape(spec(codes=CODES, duration_s=0.2))
    some = with_rows(landscape, simulate_chunk(Chunk(spec=landscape.spec, codes=(40, 120))).rows)
    assert (some.missing, some.complete) == ((3, 77), False)
    assert [chunk.codes for chunk in chunks_of(some, 1)] == [(3,), (77,)]
    with pytest.raises(ValueError, match="codes"):
        with_rows(landscape, simulate_chunk(Chunk(spec=landscape.spec, codes=(41,))).rows)


def test_another_question_has_another_fingerprint() -> None:
    from hexctl.backends.sim.world import World

    asked = [spec(), spec(leg=4), spec(self_rotation="rear"), spec(duration_s=0.5), spec(seed=1),
             spec(codes=CODES), spec(world=World(friction=0.5))]  # fmt: skip
    assert len({each.fingerprint for each in asked}) == len(asked)
    assert spec().fingerprint == spec().fingerprint


def test_numbers_are_named() -> None:
    landscape = made_up(5, "rear", np.full(120, -0.3))
    assert landscape.number("signed_m")[0] == -0.3
    assert landscape.final_m[0] == 0.3
    assert len(NUMBERS) == landscape.numbers.shape[1]
