"""From landscapes to a prior."""

import numpy as np

from hexctl.adapt.prior.prior import CHECKPOINTS
from hexctl.adapt.prior.samples import features_of
from hexctl.backends.sim.family import load_family
from hexctl.study.landscape import Landscape, LandscapeSpec, Rows, empty_landscape, with_rows
from hexctl.study.prior.build import prior_of
from hexctl.study.prior.plan import PriorPlan
from hexctl.study.prior.stances import sag_of, sags_of
from hexctl.study.transfer.course import walk_of
from hexctl.types import FloatArray
from tests.robots import shipped

PLAN = PriorPlan(robot=shipped(), family=load_family("randomised"), worlds=2, legs=(2, 5), duration_s=6.0)

#: A gait that fell half way.
FALLEN = 7


def _landscape(spec: LandscapeSpec, seed: int) -> Landscape:
    """Return a landscape of smooth random walks, of which one ends half way."""
    empty, random = empty_landscape(spec), np.random.default_rng(seed)
    paths: FloatArray = random.normal(size=(120, spec.n_points, 2)).cumsum(axis=1) * 0.01
    paths[FALLEN - 1, spec.n_points // 2 :] = np.nan
    numbers = random.normal(size=(120, 6))
    numbers[:, 0] = paths[:, -1, 1]
    status = np.full(120, "ok", dtype="<U16")
    status[FALLEN - 1] = "fell"
    rows = Rows(codes=empty.codes, status=status, numbers=numbers, paths_m=paths.astype(np.float32))
    return with_rows(empty, rows)


def test_a_prior_holds_what_a_session_would_have_been_shown() -> None:
    landscapes = [_landscape(spec, seed) for seed, spec in enumerate(PLAN.specs())]
    prior = prior_of(PLAN, landscapes)
    assert (prior.legs, prior.worlds, prior.question.duration_s) == ((2, 5), 2, 6.0)
    for landscape in landscapes:
        row = prior.legs.index(landscape.spec.leg)
        world = int(landscape.spec.place.removeprefix("world ")) - 1
        for code in (1, 50, FALLEN, 120):
            features = features_of(walk_of(landscape, code), PLAN.duration_s)
            np.testing.assert_array_equal(prior.signed_m[row, world, code - 1], features[:CHECKPOINTS])
            np.testing.assert_array_equal(prior.progress_m[row, world, code - 1, -1], features[-2])
            np.testing.assert_array_equal(prior.yaw_rad[row, world, code - 1], features[-1])


def test_each_stance_is_that_of_its_leg_and_world() -> None:
    told: list[None] = []
    sags_rad = sags_of(PLAN, lambda: told.append(None))
    assert sags_rad.shape == (2, 2, 18)
    assert len(told) == 4
    for spec in PLAN.specs():
        world = int(spec.place.removeprefix("world ")) - 1
        np.testing.assert_array_equal(sags_rad[PLAN.legs.index(spec.leg), world], sag_of(spec))
    assert len({sags_rad[leg, world].tobytes() for leg in (0, 1) for world in (0, 1)}) == 4


def test_a_fall_shows_its_first_half_and_no_end() -> None:
    prior = prior_of(PLAN, [_landscape(spec, seed) for seed, spec in enumerate(PLAN.specs())])
    fallen = prior.signed_m[:, :, FALLEN - 1]
    assert np.isfinite(fallen[..., : CHECKPOINTS // 2]).all()
    assert np.isnan(fallen[..., CHECKPOINTS // 2 :]).all()
    assert np.isnan(prior.yaw_rad[..., FALLEN - 1]).all()


def test_the_origin_names_worlds_and_code() -> None:
    origin = prior_of(PLAN, [_landscape(spec, seed) for seed, spec in enumerate(PLAN.specs())]).origin
    assert origin["family"]["seed"] == PLAN.family.seed
    assert "mujoco" in origin["code"]
