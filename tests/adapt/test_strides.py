"""Strides: a table of paces, amplitudes and swing shares, then codes with the best of them."""

from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.adaptation import adapt
from hexctl.adapt.best import best_gait
from hexctl.adapt.optimizers.strides import SLOWER, StrideSearch
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.session_optimizer import make_search
from hexctl.adapt.sessions.session_tables import flat_rows
from hexctl.adapt.setting import load_setting
from hexctl.cli.render.session_tables import header_line, walk_line
from hexctl.control.assessment.top_speed import Stride
from hexctl.control.trial_plan import GaitChange
from hexctl.errors import InputError
from hexctl.runs.run_spec import RunSpec, plan_of
from hexctl.testing.optimizer_conformance import ONE_FAILED, Make, OptimizerConformance
from tests.robots import shipped


class TestStrideSearch(OptimizerConformance):
    spaces = (ONE_FAILED,)
    seeded = False

    @pytest.fixture
    def make(self) -> Make:
        return StrideSearch


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_best_of_the_table_walks_more_slowly_and_then_with_other_orders_of_the_legs() -> None:
    spec = new_spec(failed_leg=5, objective="speed")
    setting = load_setting(spec)
    search = make_search(spec, setting.robot, setting.plan, None)
    strides: list[Stride] = []
    while not search.exhausted:
        if len(strides) == 9:  # a search that goes on from its state
            state, search = search.state(), make_search(spec, setting.robot, setting.plan, None)
            search.restore(state)
        (code,) = search.ask()
        stride = search.stride(code)
        assert stride is not None
        strides.append(stride)
        search.tell([code], [1 / (stride.pace_hz * stride.amplitude)])
    best = strides[0]
    assert strides[6].pace_hz == pytest.approx(SLOWER * best.pace_hz, abs=1e-3)
    assert strides[7:] == [best] * 23  # of the 24 orders of five legs on a circle one walked before


@pytest.mark.parametrize("given", [{"prior": "none"}, {"hold": "none"}, {"objective": "tilt"}], ids=str)
def test_other_searches_walk_at_the_pace_of_the_robot(given: dict[str, Any]) -> None:
    asked = {"objective": "speed", **given}
    assert new_spec(failed_leg=5, **asked).optimizer != "strides"


def test_strides_without_a_held_line_are_refused() -> None:
    with pytest.raises(InputError, match="strides"):
        new_spec(failed_leg=5, objective="speed", optimizer="strides", hold="none")


@pytest.mark.slow
def test_a_session_keeps_the_stride_of_each_trial_and_the_best_walks_again() -> None:
    found = adapt(5, objective="speed", budget=2, duration_s=3.0, record=False, progress=False)
    trial = found.session.trials[0]
    assert trial.stride is not None
    assert flat_rows(found.session)[0]["pace_hz"] == trial.stride.pace_hz
    _, second = found.session.trials
    assert "repeat" not in str(walk_line(found.session, second))
    assert "score s/m" in header_line(found.session)
    assert f" {100 * trial.stride.amplitude:.1f} %" in str(walk_line(found.session, trial))
    spec = best_gait(RunSpec(gait=f"best:{found.session.name}", failed_leg=5), "runs").spec
    best = found.session.best_walk
    assert best is not None
    assert best.stride is not None
    walked = load_setting(found.session.spec).plan_for(best.slots, stride=best.stride).gait
    assert plan_of(spec, shipped("ant")).gait == walked
    later = best_gait(RunSpec(gait="wave", then=[f"best:{found.session.name}@2"], failed_leg=5), "runs").spec
    assert plan_of(later, shipped("ant")).changes == (GaitChange(gait=walked, at_s=2.0),)
    slow = best_gait(RunSpec(gait=f"best:{found.session.name}", failed_leg=5, pace_hz=0.5), "runs").spec
    assert plan_of(slow, shipped("ant")).gait.pace_hz == 0.5
