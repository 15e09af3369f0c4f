"""A leg that carries nothing is noticed by where the body goes, and a whole robot has none."""

import numpy as np
import pytest

from hexctl.ik.lost_leg import JUDGED_S, WINDOW_S, LostLegWatch
from hexctl.robot.failure import Failure
from tests.driven import Command, Driven, driven
from tests.robots import shipped

AHEAD: tuple[Command, ...] = ((1, 0, 0, 0), (8, 1, 0, 0))
TURNING: tuple[Command, ...] = ((1, 0, 0, 0), (8, 0, 0, 0.7))

#: Standard deviation of sightings in m, m and rad.
NOISE = np.array([0.005, 0.005, 0.005])


def watched(
    robot: str, walk: Driven, *, wild: float = 0.0, seen_from_s: float = 0.0
) -> list[tuple[int, ...]]:
    """Legs believed lost after each state; every other state there is a sighting, some of them anywhere."""
    watch, rng = LostLegWatch(shipped(robot)), np.random.default_rng(1)
    believed = []
    for tick, (at_s, angles) in enumerate(zip(walk.times_s, walk.joints_rad, strict=True)):
        watch.listen(at_s, angles)
        off = rng.uniform(-1, 1, 3) if rng.random() < wild else rng.normal(size=3) * NOISE
        if tick % 2 == 0 and at_s >= seen_from_s:
            watch.see(at_s, walk.poses[tick] + off)
        believed.append(watch.lost_legs)
    return believed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "leg", "wild"), [("phantomx", 2, 0.0), ("pexod", 2, 0.0), ("pexod", 2, 0.1)]
)
def test_a_missing_leg_that_nobody_told_of_is_noticed(robot: str, leg: int, wild: float) -> None:
    walk = driven(robot, AHEAD, failure=Failure(leg=leg, kind="missing"), told=False)
    believed = watched(robot, walk, wild=wild)
    assert believed[-1] == (leg,)
    assert walk.times_s[believed.index((leg,))] < 7.0


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ant", "phantomx", "pexod"])
@pytest.mark.parametrize("world", ["flat", "real:3"])
@pytest.mark.parametrize("commands", [AHEAD, TURNING])
def test_a_whole_robot_has_no_lost_leg(robot: str, world: str, commands: tuple[Command, ...]) -> None:
    walk = driven(robot, commands, world=world)
    assert set(watched(robot, walk)) == {()}


def test_a_robot_that_stands_has_no_lost_leg() -> None:
    assert set(watched("ant", driven("ant", ((6, 0, 0, 0),)))) == {()}


@pytest.mark.slow
def test_a_leg_that_carries_again_is_believed_again() -> None:
    """The poses of a whole robot after those of one that lost a leg."""
    broken = driven("pexod", AHEAD, failure=Failure(leg=2, kind="missing"), told=False)
    whole = driven("pexod", AHEAD)
    watch = LostLegWatch(shipped("pexod"))
    for walk, from_s in ((broken, 0.0), (whole, 20.0)):
        if from_s:
            watch.restart()
            assert watch.lost_legs == (2,)
        for at_s, angles, pose in zip(walk.times_s, walk.joints_rad, walk.poses, strict=True):
            watch.listen(from_s + at_s, angles)
            watch.see(from_s + at_s, pose)
    assert watch.lost_legs == ()


def test_nothing_is_judged_by_a_short_sight() -> None:
    walk = driven("pexod", AHEAD, failure=Failure(leg=2, kind="missing"), told=False)
    seen_from_s = walk.times_s[-1] - 0.5 * WINDOW_S - JUDGED_S / 2
    assert watched("pexod", walk, seen_from_s=seen_from_s)[-1] == ()
