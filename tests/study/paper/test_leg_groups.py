"""Which legs are one experiment."""

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.control.body_symmetry import BodySymmetry, body_symmetries
from hexctl.study.landscape import Landscape
from hexctl.study.paper.leg_groups import experiments_of, image_of, is_mirror_of, landscape_by_symmetry
from tests.robots import shipped
from tests.study.made_up import made_up, spec, spread_out

LEGS = range(1, 7)
ALONE = tuple((leg,) for leg in LEGS)
ALL = ((1, 2, 3, 4, 5, 6),)
MIRRORED = ((1,), (2, 6), (3, 5), (4,))


@pytest.mark.parametrize(
    ("world", "rotated", "straight"),
    [
        ({}, ALL, MIRRORED),
        ({"slope_deg": 5.0}, ALL, MIRRORED),
        ({"slope_deg": 5.0, "slope_direction_deg": 90.0}, ALL, ALONE),
        ({"roughness_m": 0.01}, ALL, ALONE),
        ({"joint_offset_deg": 0.5}, ALONE, ALONE),
        ({"body_mass_shift_m": (0.01, 0.0, 0.0)}, MIRRORED, MIRRORED),
        ({"payload_kg": 1.0, "payload_position_m": (0.0, 0.02, 0.1)}, ((1, 4), (2, 3), (5, 6)), ALONE),
    ],
)
def test_legs_are_one_experiment_as_far_as_the_world_allows(
    world: dict[str, object], rotated: object, straight: object
) -> None:
    asked = World.model_validate(world)
    assert experiments_of(shipped(), asked, "rear", LEGS) == rotated
    assert experiments_of(shipped(), asked, "none", LEGS) == straight


def test_other_robots_have_fewer_symmetries() -> None:
    assert experiments_of(shipped("pexod"), World(), "rear", LEGS) == ((1, 6), (2, 5), (3, 4))


def test_a_jammed_coxa_has_a_left_and_a_right() -> None:
    assert is_mirror_of(shipped(), World(), 1, 1, "none")
    assert not is_mirror_of(shipped(), World(), 1, 1, "none", "stuck:coxa:30")
    assert is_mirror_of(shipped(), World(), 1, 1, "none", "stuck:tibia:30")


def mirror() -> BodySymmetry:
    """The mirroring that puts leg 2 in the place of leg 6."""
    (found,) = [one for one in body_symmetries(shipped()) if one.mirrored and one.keeps_heading]
    return found


def test_the_image_of_an_image_is_the_landscape() -> None:
    landscape = made_up(2, "none", spread_out(2.0, np.where(np.arange(120) % 3, 1.0, -1.0)))
    image = image_of(landscape, mirror())
    assert (image.spec.leg, image.final_m.sum()) == (6, pytest.approx(landscape.final_m.sum()))
    back = image_of(image, mirror())
    np.testing.assert_array_equal(back.number("signed_m"), landscape.number("signed_m"))
    np.testing.assert_array_equal(back.paths_m, landscape.paths_m)


def walked(leg: int, codes: list[int]) -> Landscape:
    asked = spec(leg, "none", 3.0, codes)
    return Landscape.of(asked, asked.walk(asked.codes))


def test_a_walk_mirrored_is_the_walk_of_the_image() -> None:
    """Leg 1 is its own mirror image: a gait and its image keep their phase and end alike."""
    codes = [3, 40, 77]
    image = image_of(walked(1, codes), mirror())
    again = walked(1, image.codes.tolist())
    np.testing.assert_allclose(image.number("signed_m"), again.number("signed_m"), atol=1e-4)
    assert np.abs(again.number("signed_m")).max() > 0.005


def test_legs_that_no_symmetry_reaches_have_no_image() -> None:
    second = made_up(2, "none", spread_out(1.0))
    assert landscape_by_symmetry([second], 6).spec.leg == 6
    with pytest.raises(KeyError):
        landscape_by_symmetry([second], 3)
