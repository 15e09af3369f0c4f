"""A prior answers what sessions with the same trials ask, and its ends are the ends of walks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import load_prior, save_prior
from hexctl.backends.sim.family import load_family
from hexctl.robot.failure import Failure
from hexctl.study.landscape import NUMBERS, Landscape, LandscapeSpec
from hexctl.study.prior.build import checkpoints_of, prior_of
from hexctl.study.prior.plan import PriorPlan
from tests.adapt.priors import question_of
from tests.robots import shipped
from tests.study.landscapes import made_up_in


def plan(**options: Any) -> PriorPlan:
    given = {"legs": (2, 5), "worlds": 3, "duration_s": 6.0, **options}
    return PriorPlan(robot=shipped(), family=load_family("randomised"), **given)


def told_apart(spec: LandscapeSpec, number: int) -> Landscape:
    """Return a landscape whose ends say which landscape and gait they are of, exactly."""
    landscape = made_up_in(spec, number + np.arange(120) / 128)
    landscape.paths_m[:, -1, 1] = landscape.number("signed_m")
    landscape.numbers[:, NUMBERS.index("yaw_change_rad")] = -number - np.arange(120) / 128
    return landscape


@pytest.mark.parametrize("leg", [1, 5])
@pytest.mark.parametrize("options", [
    {}, {"failure": "limp"}, {"failure": "weak"}, {"failure": "stuck"}, {"failure": "missing"},
    {"self_rotation": "front"}, {"self_rotation": "none"}, {"duration_s": 12.0},
], ids=str)  # fmt: skip
def test_it_answers_what_a_session_with_these_trials_asks(options: dict[str, Any], leg: int) -> None:
    asked = plan(worlds=2, **options)
    made = prior_of(asked, [told_apart(spec, 0) for spec in asked.specs()])
    session = question_of(
        duration_s=options.get("duration_s", 6.0),
        failure=Failure(leg=leg, kind=options.get("failure", "locked")),
        self_rotation=options.get("self_rotation", "rear"),
    )
    assert made.question.differences(session) == []


def test_every_end_is_at_its_place_whatever_the_order_of_the_legs() -> None:
    asked = plan()
    landscapes = [told_apart(spec, number) for number, spec in enumerate(asked.specs())]
    prior = prior_of(asked, landscapes)
    for landscape in landscapes:
        row, world = asked.legs.index(landscape.spec.leg), int(landscape.spec.place.split()[1]) - 1
        np.testing.assert_array_equal(prior.signed_m[row, world, :, -1], landscape.number("signed_m"))
        np.testing.assert_array_equal(prior.yaw_rad[row, world], landscape.number("yaw_change_rad"))
    by_leg = sorted(landscapes, key=lambda landscape: landscape.spec.leg)
    assert prior_of(asked, by_leg).digest() == prior.digest()


@pytest.mark.parametrize("duration_s", [6.0, 8.0, 14.0, 30.0, 50.0])
def test_checkpoints_are_tenths_of_a_walk_and_the_last_one_is_its_end(duration_s: float) -> None:
    landscape = told_apart(plan(duration_s=duration_s).specs()[0], 0)
    landscape.paths_m[..., 0] = np.arange(1, landscape.spec.n_points + 1) / landscape.spec.n_points
    kept = checkpoints_of(landscape)
    np.testing.assert_allclose(kept[0, :, 0], np.arange(1, 11) / 10, atol=1e-6)
    np.testing.assert_array_equal(kept[:, -1], landscape.paths_m[:, -1].astype(float))


def test_it_goes_into_a_file_and_comes_back_with_where_it_is_from(tmp_path: Path) -> None:
    asked = plan(worlds=2)
    prior = prior_of(asked, [told_apart(spec, 0) for spec in asked.specs()])
    save_prior(prior, tmp_path / "made.npz")
    loaded = load_prior(tmp_path / "made.npz")
    assert (loaded.digest(), loaded.head) == (prior.digest(), prior.head)
    assert loaded.origin["family"] == asked.family.model_dump(mode="json")
