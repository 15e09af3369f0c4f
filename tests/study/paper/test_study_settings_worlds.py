"""Worlds like a given one."""

import pytest

from hexctl.backends.sim.world import World, load_world
from hexctl.errors import InputError
from hexctl.study.paper.study_settings import FACTORS, nearby_worlds


def test_the_world_itself_is_the_first_and_more_continue_fewer() -> None:
    world = load_world("slippery")
    five = nearby_worlds(world, 5)
    assert five[0] == world
    assert nearby_worlds(world, 3) == five[:3]
    assert len(set(map(World.model_dump_json, five))) == 5


def test_others_differ_in_what_favours_no_leg_and_stay_in_range() -> None:
    world = World(friction=0.4, slope_deg=3.0)
    for other in nearby_worlds(world, 9)[1:]:
        for name, factor in FACTORS.items():
            assert factor.low <= getattr(other, name) / getattr(world, name) <= factor.high
        assert other.model_dump(exclude=set(FACTORS)) == world.model_dump(exclude=set(FACTORS))


@pytest.mark.parametrize("count", [0, 101])
def test_a_count_that_is_not_possible_is_refused(count: int) -> None:
    with pytest.raises(InputError, match="worlds: got"):
        nearby_worlds(World(), count)
