"""The best gait that is known for a walk."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.adaptation import adapt
from hexctl.adapt.best import best_gait
from hexctl.adapt.prior.prior import load_prior, save_prior
from hexctl.adapt.prior.samples import ranked_codes
from hexctl.adapt.sessions.session_tables import flat_rows
from hexctl.adapt.sessions.store import load_session
from hexctl.adapt.setting import load_setting
from hexctl.adapt.space import GaitSpace
from hexctl.cli.render.session_tables import header_line, walk_line
from hexctl.control.planning.static_stability import STAND_UP
from hexctl.control.planning.top_speed import Stride
from hexctl.control.trial_plan import GaitChange
from hexctl.errors import InputError
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.gait.posture import Posture
from hexctl.robot.failure import Failure
from hexctl.runs.run import Run, run
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from tests.adapt.priors import key_of, made_up_prior, made_up_score_prior
from tests.adapt.walking import closing_lines, stored_session
from tests.robots import shipped

LIMP = Failure(leg=2, kind="limp")


def spec(**options: Any) -> RunSpec:
    return RunSpec(**{"gait": "best", "failure": LIMP, **options})


@pytest.fixture
def built(tmp_path: Path) -> Path:
    """A folder with priors of limp legs, for which none is shipped: of steered and of open-loop walks."""
    line = replace(key_of(failure=LIMP, hold="line", self_rotation="none"), posture="auto")
    save_prior(made_up_score_prior(line, legs=(2,)), tmp_path / "priors" / "line.npz")
    save_prior(made_up_prior(key_of(failure=LIMP), legs=(2,)), tmp_path / "priors" / "none.npz")
    return tmp_path


def test_by_a_prior_it_is_the_fastest_of_its_worlds_whatever_the_duration(built: Path) -> None:
    prior = made_up_score_prior(legs=(2,))
    fastest = int(np.argmin(prior.log_scores[0, :, :, 0].mean(axis=0))) + 1
    for duration_s in (30.0, 12.0):
        found = best_gait(spec(duration_s=duration_s), built)
        assert found.source == f"gait {fastest}, the best by the prior line.npz"
        assert found.spec.gait == GaitSpace((2,)).slots_of(fastest)
        assert found.spec.body_raise == 0.0
        assert Run(found.spec).plan.self_rotation == "none"
        assert replace(found.spec, gait="best", chosen_gait=False, body_raise=None) == spec(
            duration_s=duration_s
        )


def test_without_a_hold_it_is_the_straightest(built: Path) -> None:
    found = best_gait(spec(hold="none"), built)
    best = ranked_codes(load_prior(built / "priors" / "none.npz"), shipped(), 2)[0]
    assert found.source == f"gait {best}, the best by the prior none.npz"
    assert Run(found.spec).plan.self_rotation == "rear"


def test_by_a_session_it_is_that_of_its_best_trial(tmp_path: Path) -> None:
    session = adapt(
        2, budget=2, duration_s=3.0, objective="speed", prior="none", baseline=False, record=False,
        folder=tmp_path,
    ).session  # fmt: skip
    name = f"best:{session.name}"
    found = best_gait(spec(gait=name, failure=Failure(leg=2)), tmp_path)
    assert session.best is not None
    assert found.spec.gait == session.best.slots
    assert (found.spec.body_raise, found.spec.self_rotation) == (STAND_UP, "none")
    assert (
        found.source == f"gait {session.best.code}, trial {session.best.index} of the session {session.name}"
    )
    by_prior = best_gait(spec(failure=Failure(leg=2)), tmp_path)
    assert by_prior.source.endswith(f"; the last search for this leg: {name}")
    with pytest.raises(InputError, match=r"a session with leg 2 locked; allowed: with leg 2 limp"):
        best_gait(spec(gait=name), tmp_path)
    with pytest.raises(InputError, match="a session of ant; allowed: of pexod"):
        best_gait(spec(gait=name, failure=Failure(leg=2), robot="pexod"), tmp_path)


@pytest.mark.parametrize(
    ("ends_m", "gait", "source"),
    [
        ({"tripod": 0.01, "auto": 0.02}, NAMED_SLOTS["tripod"], "gait tripod, as good as any trial of the s"),
        ({"tripod": 0.02, "auto": 0.01}, GaitSpace((2,)).slots_of(42), "gait auto, as good as any trial of"),
        ({"tripod": 0.04, "auto": 0.05}, GaitSpace((2,)).slots_of(17), "gait 17, trial 1 of the session"),
    ],
    ids=["tripod", "auto", "trial"],
)
def test_by_a_session_it_is_that_of_the_baseline_where_no_trial_is_better(
    tmp_path: Path, ends_m: dict[str, float], gait: tuple[int, ...], source: str
) -> None:
    name = f"best:{stored_session(tmp_path, 0.03, **ends_m)}"
    found = best_gait(spec(gait=name, failure=Failure(leg=2)), tmp_path)
    assert found.source.startswith(source)
    assert Run(found.spec).plan.gait.slots == gait
    later = best_gait(spec(gait="wave", then=(f"{name}@2",), failure=Failure(leg=2)), tmp_path)
    assert later.source == f"from 2 s on {found.source}"
    (change,) = Run(later.spec).plan.changes
    assert change.gait.slots == gait


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["none", "heading"])
def test_by_a_session_that_trims_it_walks_with_the_trim(hold: str, tmp_path: Path) -> None:
    session = adapt(
        2, budget=2, duration_s=4.0, hold=hold, target_m=1e-9, baseline=False, record=False, folder=tmp_path
    ).session
    best = session.best_walk
    assert best is not None
    trim_rad, turn_rad_s = best.trim.course_rad, best.trim.turn_rad_s if hold == "none" else None
    assert trim_rad
    asked = spec(gait=f"best:{session.name}", failure=Failure(leg=2), hold=hold)
    found = best_gait(asked, tmp_path)
    plan = Run(found.spec).plan
    assert plan.trim_rad == pytest.approx(trim_rad)
    assert plan.turn_trim_rad_s == pytest.approx(turn_rad_s)
    assert f"with its trim of {math.degrees(trim_rad):.2f} degrees" in found.source
    assert f"--trim {math.degrees(trim_rad):.4f}" in closing_lines(session, "budget")
    assert best_gait(replace(asked, hold="line"), tmp_path).spec.trim_rad is None
    if hold == "heading":
        assert best_gait(replace(asked, trim_rad=0.01), tmp_path).spec.trim_rad == 0.01
        return
    given = best_gait(replace(asked, turn_rate_rad_s=0.01, heading_rad=0.1), tmp_path).spec
    assert (given.turn_rate_rad_s, given.trim_rad) == (0.01, None)
    later = best_gait(replace(asked, gait="wave", then=(f"{asked.gait}@2",)), tmp_path)
    assert later.spec.turn_trim_rad_s is None
    assert "its trim" not in later.source


def test_a_walk_may_change_to_the_best_gait(built: Path) -> None:
    first = best_gait(spec(), built)
    found = best_gait(spec(gait="wave", then=("tripod@1", "best@2")), built)
    assert found.source == f"from 2 s on {first.source}"
    assert found.spec.gait == "wave"
    changes = Run(found.spec).plan.changes
    assert [change.at_s for change in changes] == [1.0, 2.0]
    assert changes[1].gait.slots == first.spec.gait
    both = best_gait(spec(then=("best@2",)), built)
    assert both.spec == replace(first.spec, then=found.spec.then[1:])
    with pytest.raises(InputError, match="then"):
        run(spec(gait="wave", then=("best@2",)))
    with pytest.raises(InputError, match="then"):
        best_gait(spec(gait="wave", then=("best:nowhere@2",)), built)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"failure": None}, "gait"),
        ({"failure": Failure(leg=2, kind="missing")}, "missing"),
        ({"pace_hz": 0.5}, "line.npz"),
        ({"turn_rate_rad_s": 0.1, "heading_rad": 0.0}, "turn"),
        ({"gait": "best:nowhere"}, "nowhere"),
        ({"gait": "auto"}, "auto"),
    ],
    ids=str,
)
def test_without_anything_known_the_best_gait_is_refused(
    built: Path, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        best_gait(spec(**options), built)


@pytest.mark.parametrize("body_raise", [None, 0.03])
def test_by_a_session_that_searched_strides_the_best_walks_again(
    body_raise: float | None, tmp_path: Path
) -> None:
    stride = Stride(pace_hz=0.9, amplitude=0.07, swing_share=0.4)
    name = stored_session(tmp_path, 0.03, "strides", stride)
    session, asked = load_session(name, tmp_path), spec(gait=f"best:{name}", failure=Failure(leg=2))
    asked = replace(asked, body_raise=body_raise)
    walked = load_setting(session.spec).plan_for(session.trials[0].slots, stride=stride).gait
    if body_raise is not None:
        walked = replace(walked, posture=Posture(body_raise=body_raise))
    assert plan_walk(best_gait(asked, tmp_path).spec, shipped()).gait == walked
    later = best_gait(replace(asked, gait="wave", then=(f"{asked.gait}@2",)), tmp_path).spec
    assert plan_walk(later, shipped()).changes == (GaitChange(gait=walked, at_s=2.0),)
    slow = best_gait(replace(asked, pace_hz=0.5), tmp_path).spec
    assert plan_walk(slow, shipped()).gait == replace(walked, pace_hz=0.5)


@pytest.mark.slow
def test_a_session_keeps_the_stride_of_each_trial(tmp_path: Path) -> None:
    session = adapt(2, objective="speed", budget=2, duration_s=3.0, record=False, folder=tmp_path).session
    first, second = session.trials
    assert first.stride is not None
    assert flat_rows(session)[0]["pace_hz"] == first.stride.pace_hz
    assert "repeat" not in str(walk_line(session, second))
    assert "score s/m" in header_line(session)
    assert f" {100 * first.stride.amplitude:.1f} %" in str(walk_line(session, first))
