"""Episodes: what they ask of the robot, and what is read from a walk."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.control.assessment.static_stability import most_stable_slots
from hexctl.study.recovery.episodes import RecoveryCase, RecoveryPlace, Track
from tests.robots import shipped
from tests.study.recovery.made_up import IDEAL_M_S, alarm, episode

CASE = RecoveryCase(
    gait="tripod", legs=(2,), failure="stuck:tibia", at_s=8.3, heading_deg=60.0, method="recover"
)
PLACE = RecoveryPlace(
    protocol="line",
    robot=shipped(),
    family="transfer",
    number=205,
    kind="rough",
    world=World(roughness_m=0.003),
    duration_s=20.0,
)


def test_nothing_of_what_will_fail_is_told_in_the_plan() -> None:
    trial = PLACE.trial(CASE)
    assert (trial.failure, trial.plan.belief, trial.seed, trial.plan.hold) == (None, None, 205, "line")
    assert [str(event) for event in trial.events] == ["2:stuck:tibia@8.3"]
    assert trial.plan.gait.slots == (1, 4, 1, 4, 1, 4)
    assert trial.plan.heading_rad == pytest.approx(math.radians(60))
    auto = PLACE.trial(replace(CASE, gait="auto", legs=(1, 4), failure="limp"))
    assert auto.plan.gait.slots == most_stable_slots(shipped(), heading_rad=math.radians(60))
    assert [str(event) for event in auto.events] == ["1:limp@8.3", "4:limp@8.3"]


@pytest.mark.slow
def test_whatever_decides_a_walk_is_in_the_fingerprint() -> None:
    changes: list[dict[str, Any]] = [
        {"robot": shipped("pexod")},
        {"number": 206},
        {"world": World()},
        {"duration_s": 60.0},
    ]
    prints = {replace(PLACE, **change).fingerprint for change in changes}
    assert len(prints | {PLACE.fingerprint}) == len(changes) + 1


def test_the_first_alarm_of_a_walk_counts() -> None:
    right = episode(CASE)
    assert (right.right_leg, right.right_kind, right.early) == (True, True, ())
    assert right.delay_s == pytest.approx(0.3)
    wrongs: list[tuple[dict[str, Any], bool]] = [
        ({"kind": "limp"}, True),
        ({"joint": None}, True),
        ({"leg": 3}, False),
    ]
    for wrong, leg in wrongs:
        other = episode(CASE, alarms=(alarm(CASE, **wrong),))
        assert (other.right_leg, other.right_kind) == (leg, False)
    early = episode(CASE, alarms=(alarm(CASE, after_s=-2.0), alarm(CASE)))
    assert (early.right_leg, len(early.early)) == (False, 1)
    assert early.delay_s == pytest.approx(0.3)
    missed = episode(CASE, alarms=())
    assert (missed.right_leg, math.isnan(missed.delay_s)) == (False, True)
    intact = replace(CASE, legs=(), failure="intact")
    assert len(episode(intact, alarms=(alarm(CASE),)).early) == 1


def test_a_walk_recovers_that_stays_on_its_feet_and_has_half_of_the_speed() -> None:
    assert episode(CASE, last_m_s=0.5 * IDEAL_M_S).recovered
    assert not episode(CASE, last_m_s=0.49 * IDEAL_M_S).recovered
    fell = episode(CASE, status="fell")
    assert not fell.recovered
    assert math.isnan(fell.final_m)


def test_speeds_are_those_of_the_true_way_along_the_line() -> None:
    track = walked([0.2] * 500 + [0.1] * 500)
    assert track.speed(4.0, 8.0) == pytest.approx(0.2)
    assert track.speed(15.0, 20.0) == pytest.approx(0.1)
    assert math.isnan(track.speed(19.9, 20.0))
    assert track.way_m(10.0) == pytest.approx(0.03)
    assert math.isnan(Track(np.zeros((0, 2)), 0.0, 1.0).speed(4.0, 8.0))


def test_a_walk_settles_when_its_speed_is_back_after_its_lowest() -> None:
    dip = walked([0.2] * 500 + [0.05] * 100 + [0.15] * 400)  # two seconds from the failure at 10 s
    assert dip.settled_s(10.0, 0.15) == pytest.approx(2.35, abs=0.05)
    assert walked([0.2] * 1000).settled_s(10.0, 0.2) == 0.0
    assert math.isnan(walked([0.2] * 500 + [0.0] * 500).settled_s(10.0, 0.1))
    assert math.isnan(walked([0.2] * 500).settled_s(10.0, 0.1))


def walked(speeds_m_s: list[float]) -> Track:
    """Track with a speed at each tick, 3 cm to the right of the line, of cycles of a second."""
    path_m = np.stack([0.02 * np.cumsum(speeds_m_s), np.full(len(speeds_m_s), -0.03)], axis=-1)
    return Track(path_m, 0.02, 1.0)
