"""Building a repertoire: interrupted and continued, on a cluster, and what its file then says."""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from hexctl.control.monitor.repertoire_store import load_repertoire
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.study import repertoire_walks, walking
from hexctl.study.repertoire_plan import build_repertoire, repertoire_of
from hexctl.study.repertoire_walks import CandidateWalk, RepertoireCase, RepertoirePlace
from hexctl.study.walk_cache import WalkCache
from tests.study.made_up_repertoire import plan
from tests.study.watching import Remembering

PLAN = plan(worlds=2, directions=1, failures=("limp",))


def _made_up_walks(monkeypatch: pytest.MonkeyPatch) -> None:
    def walk(
        _place: RepertoirePlace, cases: Sequence[RepertoireCase], _threads: int = 1
    ) -> list[CandidateWalk]:
        return [
            CandidateWalk(case=case, status="ok", speed=0.5 + 0.01 * number, cost=0.3)
            for number, case in enumerate(cases)
        ]

    monkeypatch.setattr(RepertoirePlace, "walk", walk)
    monkeypatch.setattr(repertoire_walks, "TOGETHER", 1)


@pytest.mark.slow
def test_what_was_interrupted_goes_on_from_what_has_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _made_up_walks(monkeypatch)
    cache, out = WalkCache(tmp_path / "cache"), tmp_path / "ant.npz"
    with pytest.raises(KeyboardInterrupt):
        build_repertoire(PLAN, out, cache=cache, jobs=1, progress=Remembering(interrupt_after=5))
    assert not out.exists()
    saved, total = cache.count(PLAN.walked())
    assert 0 < saved < total
    left = Remembering()
    built = build_repertoire(PLAN, out, cache=cache, jobs=1, progress=left)
    assert left.steps == total - saved
    assert load_repertoire(out).digest() == built.digest()
    again = Remembering()
    build_repertoire(PLAN, out, cache=cache, jobs=1, progress=again)
    assert again.steps == 0


def test_a_repertoire_says_how_its_candidates_walked() -> None:
    walks = [
        CandidateWalk(
            case=case,
            status="ok",
            speed=0.9 if case.candidate.name == "walk-on" else 0.5 + 0.1 * place,
            cost=0.3,
        )
        for place, (_, cases) in enumerate(PLAN.walked())
        for case in cases
    ]
    repertoire = repertoire_of(PLAN, walks)
    first = repertoire.situations[0]
    assert first.walks == 2
    np.testing.assert_allclose(first.speeds[0], [0.5, 0.6])
    for leg in range(1, 7):
        choice = repertoire.choice((Failure(leg=leg, kind="limp"),), 0.0)
        assert choice is not None
        assert choice.candidate.name == "walk-on"
    assert repertoire.choice((Failure(leg=1, kind="locked"),), 0.0) is None


def test_what_cannot_be_written_is_refused_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ends in \.npz"):
        build_repertoire(PLAN, tmp_path / "x.zip", cache=WalkCache(tmp_path))


@pytest.mark.slow
def test_walks_of_a_cluster_are_those_of_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is sent to workers can be pickled, and what they send back is kept like any other walk."""
    few = plan(directions=1)
    alone = build_repertoire(few, tmp_path / "a.npz", cache=WalkCache(tmp_path / "a"), jobs=1)

    @contextmanager
    def pool(_address: str) -> Iterator[Executor]:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
            yield executor

    monkeypatch.setattr(walking, "dask_executor", pool)
    cache = WalkCache(tmp_path / "b")
    spread = build_repertoire(few, tmp_path / "b.npz", cache=cache, dask="tcp://127.0.0.1:1")
    assert spread.digest() == alone.digest()
    saved, total = cache.count(few.walked())
    assert saved == total > 0
