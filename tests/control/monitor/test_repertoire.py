"""What a repertoire has for failures and directions."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hexctl.control.body_symmetry import IDENTITY
from hexctl.control.monitor.repertoire import Candidate, Repertoire, Situation
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.gait.posture import Posture
from hexctl.robot.failure import Failure
from tests.control.monitor.repertoires import (
    MIRROR,
    ON,
    ON_IS_BEST,
    OTHER,
    OTHER_IS_BEST,
    SAFE,
    TURN,
    made_up,
    situation,
    with_fall,
)
from tests.robots import shipped

STUCK = (Failure(leg=2, kind="stuck", joint="femur"),)


def test_a_failure_is_looked_up_by_leg_kind_and_joint() -> None:
    repertoire = made_up()
    found = repertoire.choice(STUCK, 0.0)
    assert found is not None
    assert (found.candidate, found.walks) == (ON, 4)
    assert found.gain == pytest.approx(0.205)
    gone = repertoire.choice((Failure(leg=2, kind="missing"),), 0.0)
    assert gone is not None
    assert gone.candidate == OTHER
    for other in (
        Failure(leg=3, kind="stuck", joint="femur"),
        Failure(leg=2, kind="stuck", joint="tibia"),
        Failure(leg=2, kind="limp", joint="femur"),
    ):
        assert repertoire.choice((other,), 0.0) is None
    assert repertoire.choice((*STUCK, Failure(leg=3)), 0.0) is None
    assert repertoire.choice((), 0.0) is None


def test_the_angle_of_a_joint_that_sticks_does_not_matter() -> None:
    assert made_up().choice((replace(STUCK[0], angle_rad=0.3),), 0.0) is not None


def test_the_nearest_direction_counts_and_those_beyond_half_a_step_are_others() -> None:
    repertoire = made_up(ON_IS_BEST)
    assert repertoire.choice(STUCK, math.radians(14.0)) is not None
    assert repertoire.choice(STUCK, math.radians(-14.0)) is not None
    assert repertoire.choice(STUCK, math.radians(16.0)) is None
    assert repertoire.choice(STUCK, math.radians(360.0 - 14.0)) is not None
    assert repertoire.choice(STUCK, math.pi) is None


def test_alike_situations_share_what_one_has_walked() -> None:
    repertoire = made_up(OTHER_IS_BEST, symmetries=(IDENTITY, MIRROR, TURN))
    there = repertoire.choice((Failure(leg=2, kind="missing"),), 0.0)
    mirrored = repertoire.choice((Failure(leg=6, kind="missing"),), 0.0)
    turned = repertoire.choice((Failure(leg=1, kind="missing"),), math.radians(-60.0))
    assert there is not None
    assert mirrored is not None
    assert turned is not None
    assert there.candidate == OTHER
    assert mirrored.candidate.tucked_legs == (6,)
    assert mirrored.candidate.slots == (2, 6, 5, 4, 3, 1)
    assert mirrored.candidate.shift == (0.02, -0.03)
    assert turned.candidate.tucked_legs == (1,)
    assert turned.candidate.slots == (1, 3, 4, 5, 6, 2)
    assert np.linalg.norm(turned.candidate.shift) == pytest.approx(np.hypot(0.02, 0.03), abs=1e-6)
    assert math.degrees(math.atan2(*turned.candidate.shift[::-1])) == pytest.approx(56.31 - 60, abs=0.01)
    assert repertoire.choice((Failure(leg=1, kind="missing"),), 0.0) is None


@pytest.mark.parametrize(
    ("changed", "best"),
    [
        (ON_IS_BEST, ON),
        (with_fall(ON_IS_BEST, 1), SAFE),  # what fell more often is not better
        (with_fall(ON_IS_BEST, 0), ON),
        (situation([[0.7, 0.7, 0.7], [0.9, 0.5, 0.9], [0.7, 0.7, 0.7]]), SAFE),  # noise
        (situation([[0.7, 0.7, 0.7], [0.71, 0.71, 0.71], [0.7, 0.7, 0.7]]), SAFE),  # a percent
        (situation([[0.7], [0.9], [0.8]]), SAFE),  # one walk says nothing of the noise
        (situation([[0.7, 0.5], [0.9, 0.7], [0.6, 0.6]]), ON),  # worlds differ, the gain does not
    ],
)
def test_another_gait_is_better_beyond_the_noise_only(changed: Situation, best: object) -> None:
    assert _best(changed) == best


def test_of_several_that_are_better_the_one_that_is_so_most_surely_is_taken() -> None:
    sure = situation([[0.5, 0.5, 0.5], [0.6, 0.9, 0.9], [0.7, 0.7, 0.7]])
    assert _best(sure) == OTHER


def test_situations_of_one_kind_speak_for_each_other() -> None:
    """Walking on is faster in each, which one alone does not show."""
    noisy = [
        situation([[0.6, 0.6, 0.6], [0.9, 0.5, 1.0], [0.6, 0.6, 0.6]], heading_deg=0.0),
        situation([[0.6, 0.6, 0.6], [0.55, 0.95, 0.8], [0.6, 0.6, 0.6]], heading_deg=30.0),
        situation([[0.6, 0.6, 0.6], [0.8, 0.9, 0.6], [0.6, 0.6, 0.6]], heading_deg=60.0),
    ]
    assert [_best(one) for one in noisy] == [SAFE] * 3
    assert made_up(*noisy).best == (1, 1, 1)


def test_situations_that_differ_are_judged_each_by_itself() -> None:
    one = situation([[0.6, 0.6, 0.6], [0.9, 0.9, 0.91], [0.6, 0.6, 0.6]], heading_deg=0.0)
    other = situation([[0.6, 0.6, 0.6], [0.2, 0.2, 0.21], [0.6, 0.6, 0.6]], heading_deg=30.0)
    assert made_up(one, other).best == (1, 0)


def test_pairs_stand_alone() -> None:
    failed = ((2, "limp", None), (3, "limp", None))
    sure = situation([[0.6, 0.6], [0.9, 0.9], [0.6, 0.6]], failed, 0.0)
    slower = [situation([[0.6, 0.6], [0.5, 0.51], [0.6, 0.6]], failed, 30.0 * k) for k in range(1, 6)]
    assert made_up(sure, *slower).best == (1, 0, 0, 0, 0, 0)


def test_what_worlds_share_is_no_evidence_of_many() -> None:
    """Three situations in one lucky world and one unlucky world are two worlds."""
    lucky = [situation([[0.6, 0.6], [0.95, 0.57], [0.6, 0.6]], heading_deg=30.0 * k) for k in range(6)]
    assert made_up(*lucky).best == (0,) * 6


def _best(one: Situation) -> Candidate:
    """Best candidate of a situation by itself."""
    return one.candidates[made_up(one).best[0]]


@pytest.mark.parametrize(
    "changes",
    [
        {"hold": "none"},
        {"turn_rate_rad_s": 0.1},
        {"travel": 0.0},
        {"belief": Failure(leg=5)},
        {"gait": {"pace_hz": 0.7}},
        {"gait": {"amplitude": 0.08}},
        {"gait": {"height": 0.05}},
        {"gait": {"posture": Posture(body_raise=0.02)}},
        {"gait": {"swing_share": 0.25}},
    ],
    ids=str,
)
def test_walks_of_another_sort_are_not_covered(changes: dict[str, object]) -> None:
    plan = TrialPlan(gait=make_gait(shipped(), "tripod"), hold="line")
    assert made_up().covers(shipped(), plan)
    asked = dict(changes)
    if isinstance(gait := asked.pop("gait", None), dict):
        asked["gait"] = replace(plan.gait, **gait)
    assert not made_up().covers(shipped(), replace(plan, **asked))  # type: ignore[arg-type]


def test_other_robots_are_not_covered_and_nearly_the_same_pace_is() -> None:
    plan = TrialPlan(gait=make_gait(shipped("pexod"), "tripod"), hold="line")
    assert not made_up().covers(shipped("pexod"), plan)
    paced = TrialPlan(gait=make_gait(shipped(), "wave", pace_hz=0.8), hold="auto")
    assert made_up().covers(shipped(), paced)


def test_rows_must_fit() -> None:
    with pytest.raises(ValueError, match="speeds has shape"):
        situation([[0.5, 0.5]])


def test_a_repertoire_without_situations_has_nothing() -> None:
    empty: Repertoire = replace(made_up(), situations=())
    assert empty.choice(STUCK, 0.0) is None
