"""Priors: which landscapes they are built from, and what their files hold."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import CHECKPOINTS, PriorKey, load_score_prior, save_prior
from hexctl.adapt.prior.samples import features_of
from hexctl.backends.sim.world import Kind, load_randomization
from hexctl.control.planning.static_stability import STAND_UP, in_posture
from hexctl.errors import InputError
from hexctl.robot.failure import BROKEN_KINDS, Failure, drawn_failure
from hexctl.study.landscape import NUMBERS, Landscape, LandscapeSpec
from hexctl.study.priors.prior_building import (
    PriorPlan,
    deflection_of,
    deflections_of,
    prior_file_name,
    prior_of,
    score_prior_of,
)
from hexctl.study.priors.prior_options import WORLDS_PER_LEG
from hexctl.study.transfer.transfer_plan import walk_of
from hexctl.types import FloatArray
from tests.adapt.priors import key_of, plan_of
from tests.robots import shipped
from tests.study.made_up import Remembering, made_up_in

FAMILY = load_randomization("randomised")


def plan(**options: Any) -> PriorPlan:
    return PriorPlan(**{"robot": shipped(), "family": FAMILY, **options})


def test_a_family_that_sets_a_step_keeps_it() -> None:
    family = FAMILY.model_copy(update={"kinds": (Kind(name="fine", world={"time_step_s": 0.001}),)})
    specs = plan(worlds=2, family=family).specs()
    assert {spec.world.time_step_s for spec in specs} == {0.001}


def prior_plan(**options: Any) -> PriorPlan:
    return plan(**{"legs": (2, 5), "worlds": 2, "duration_s": 6.0, **options})


PLAN = prior_plan()

#: A gait that fell half way.
FALLEN = 7


def _landscape(spec: LandscapeSpec, seed: int) -> Landscape:
    """A landscape of smooth random walks, of which one ends half way."""
    random = np.random.default_rng(seed)
    paths: FloatArray = random.normal(size=(120, spec.n_points, 2)).cumsum(axis=1) * 0.01
    paths[FALLEN - 1, spec.n_points // 2 :] = np.nan
    numbers = random.normal(size=(120, len(NUMBERS)))
    numbers[:, 0] = paths[:, -1, 1]
    status = np.full(120, "ok", dtype="<U16")
    status[FALLEN - 1] = "fell"
    return Landscape(spec=spec, status=status, numbers=numbers, paths_m=paths.astype(np.float32))


@pytest.mark.parametrize("leg", [1, 5])
@pytest.mark.parametrize("options", [
    {}, {"failure": "limp"}, {"failure": "weak"}, {"failure": "stuck"}, {"failure": "missing"},
    {"self_rotation": "front"}, {"self_rotation": "none"}, {"duration_s": 12.0},
], ids=str)  # fmt: skip
def test_it_answers_what_a_session_with_these_trials_asks(options: dict[str, Any], leg: int) -> None:
    asked = prior_plan(**options)
    made = prior_of(asked, [_landscape(spec, 0) for spec in asked.specs()])
    session = key_of(
        duration_s=options.get("duration_s", 6.0),
        failure=Failure(leg=leg, kind=options.get("failure", "locked")),
        self_rotation=options.get("self_rotation", "rear"),
    )
    assert made.key.differences(session) == []


def test_a_prior_holds_what_a_session_would_have_been_shown() -> None:
    landscapes = [_landscape(spec, seed) for seed, spec in enumerate(PLAN.specs())]
    prior = prior_of(PLAN, landscapes)
    assert (prior.legs, prior.worlds, prior.key.duration_s) == ((2, 5), 2, 6.0)
    for landscape in landscapes:
        row = prior.legs.index(landscape.spec.leg)
        world = int(landscape.spec.place.removeprefix("world ")) - 1
        for code in (1, 50, FALLEN, 120):
            features = features_of(walk_of(landscape, code), PLAN.duration_s)
            np.testing.assert_array_equal(prior.signed_m[row, world, code - 1], features[:CHECKPOINTS])
            np.testing.assert_array_equal(prior.progress_m[row, world, code - 1, -1], features[-2])
            np.testing.assert_array_equal(prior.yaw_rad[row, world, code - 1], features[-1])


def test_each_stance_is_that_of_its_leg_and_world() -> None:
    landscapes = [_landscape(spec, 0) for spec in PLAN.specs()]
    progress = Remembering()
    sags_rad = deflections_of(PLAN, landscapes, progress)
    assert sags_rad.shape == (2, 2, 18)
    assert progress.steps == 4
    for spec in PLAN.specs()[1:3]:
        world = int(spec.place.removeprefix("world ")) - 1
        np.testing.assert_array_equal(sags_rad[PLAN.legs.index(spec.leg), world], deflection_of(spec))
    assert len({sags_rad[leg, world].tobytes() for leg in (0, 1) for world in (0, 1)}) == 4


def test_in_each_world_of_an_unknown_failure_something_of_its_own_breaks() -> None:
    specs = plan(worlds=16, failure="unknown").specs()
    assert len({spec.seed for spec in specs}) == len(specs)
    broken = [drawn_failure(spec.robot, spec.leg_failure, spec.seed) for spec in specs]
    kinds = [one.kind for one in broken if one is not None]
    assert min(kinds.count(kind) for kind in BROKEN_KINDS) >= len(specs) // 10
    assert {spec.seed for spec in plan(worlds=2).specs()} == {0}, "nothing else is drawn with the seed"


def _steered(spec: LandscapeSpec) -> Landscape:
    """A made-up landscape of steered walks, in which one gait fell, one made no progress, one went back."""
    landscape = made_up_in(spec, np.zeros(120), invalid=[5, 9])
    landscape.status[FALLEN - 1] = "fell"
    for column, name in enumerate(("distance_m", "cost_of_transport", "tilt_deg", "steadiness")):
        landscape.numbers[:, NUMBERS.index(name)] = (1 + np.arange(120) / 120) * 2.0**column
    landscape.numbers[8, NUMBERS.index("distance_m")] = -0.1
    return landscape


def test_under_a_hold_a_prior_is_of_the_logarithms_of_the_scores(tmp_path: Path) -> None:
    asked = prior_plan(hold="line", self_rotation="none")
    prior = score_prior_of(asked, [_steered(spec) for spec in asked.specs()])
    scale = 1 + np.arange(120) / 120
    wanted = np.log(np.stack([6.0 / scale, 2 * scale, 4 * scale, 8 * scale], axis=-1))
    wanted[[FALLEN - 1, 8]] = np.nan
    np.testing.assert_allclose(prior.log_scores, np.broadcast_to(wanted, (2, 2, 120, 4)), atol=1e-12)
    assert np.flatnonzero(~prior.valid[1, 1]).tolist() == [4, FALLEN - 1, 8]
    save_prior(prior, tmp_path / "made.npz")
    loaded = load_score_prior(tmp_path / "made.npz")
    assert (loaded.digest, loaded.head) == (prior.digest, prior.head)
    np.testing.assert_allclose(loaded.log_scores, prior.log_scores, rtol=1e-6)
    np.testing.assert_array_equal(loaded.valid, prior.valid)


def test_a_prior_under_a_hold_stands_as_its_sessions_do_and_is_for_them() -> None:
    asked = prior_plan(hold="line", self_rotation="none", legs=(2, 4))
    assert {spec.leg: spec.trial(1).plan.gait.posture.body_raise for spec in asked.specs()} == {
        2: STAND_UP, 4: 0.0,
    }  # fmt: skip
    plan = plan_of(shipped(), duration_s=6.0, self_rotation="none", hold="auto")
    assert asked.key.differences(PriorKey.of(shipped(), plan)) == ["posture auto, not stance"]
    for other in (plan, replace(plan, failures=(Failure(leg=2),))):
        session = in_posture(shipped(), other, "auto")
        assert asked.key.differences(PriorKey.of(shipped(), session)) == []
    assert prior_file_name(asked, "randomised") == "ant-locked-none-6s-line-leg24.npz"


def test_what_cannot_be_built_is_refused_before_anything_runs() -> None:
    for worlds in (2, WORLDS_PER_LEG):
        plan(worlds=worlds, legs=(5,)).check()
    for worlds in (1, WORLDS_PER_LEG + 1):
        with pytest.raises(InputError, match="worlds"):
            plan(worlds=worlds).check()
    with pytest.raises(InputError, match="family"):
        replace(plan(worlds=2), family=load_randomization("failing")).check()
    with pytest.raises(InputError, match="hold"):
        prior_plan(hold="auto").check()
    robot = shipped("phantomx")
    long_strides = replace(robot, gait=replace(robot.gait, amplitude=0.3))
    with pytest.raises(InputError, match="phantomx, leg 2"):
        replace(plan(worlds=2, legs=(2,)), robot=long_strides).check()
