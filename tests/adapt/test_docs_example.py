"""The optimizer that docs/adaptation.md writes out is a good one."""

import re
import sys
from pathlib import Path

import pytest

from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.testing.optimizer_conformance import ONE_FAILED, Make, OptimizerConformance, search

PAGE = Path(__file__).resolve().parents[2] / "docs" / "adaptation.md"


@pytest.fixture
def nearby(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    (program,) = [block for block in blocks if "class Nearby" in block]
    (tmp_path / "nearby.py").write_text(program, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "nearby", raising=False)
    return lambda space, seed: make_optimizer("nearby:Nearby", space, seed)


class TestNearby(OptimizerConformance):
    @pytest.fixture
    def make(self, nearby: Make) -> Make:
        return nearby


class TestNearbyCounted(OptimizerConformance):
    @pytest.fixture
    def make(self, nearby: Make) -> Make:
        return lambda space, seed: Deduplication(nearby(space, seed), seed)


def test_it_tries_all_codes_and_uses_the_distance(nearby: Make) -> None:
    best = 30
    away = ONE_FAILED.phase_distance[best - 1]
    trials = [
        search(nearby(ONE_FAILED, seed), 120, landscape=lambda code: float(away[code - 1]))
        for seed in range(20)
    ]
    assert all(sorted(codes) == list(range(1, 121)) for codes in trials)
    # By chance the best one would be found after 60 trials in the mean, with a standard error of 8.
    assert sum(codes.index(best) for codes in trials) / 20 < 30
