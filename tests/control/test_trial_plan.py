"""What a trial may be asked to do."""

import math
import pickle

import pytest

from hexctl.control.trial_plan import TrialPlan, suited_rotation
from hexctl.errors import InputError
from hexctl.robot.failure import FAILURE_KINDS, Failure
from tests.robots import shipped
from tests.trials import gait_of


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"duration_s": 0}, "duration: got 0; allowed: above 0 up to 86400 s"),
        ({"duration_s": -1}, "duration: got -1"),
        ({"duration_s": math.nan}, "duration: got nan"),
        ({"duration_s": math.inf}, "duration: got inf"),
        ({"duration_s": 1e6}, "duration: got 1e\\+06"),
        ({"settle_s": 0}, "settle time: got 0; allowed: above 0 s"),
        ({"settle_s": math.inf}, "settle time: got inf"),
        ({"self_rotation": "left"}, "self-rotation: got left; allowed: rear, front, none"),
        ({"heading_rad": math.nan}, "heading nan"),
        ({"turn_rate_rad_s": math.inf}, "turn inf"),
        ({"travel": 2.0}, "travel: got 2.0; allowed: 0..1"),
    ],
)
def test_a_plan_refuses_what_cannot_be_done(change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        TrialPlan(gait=gait_of(shipped()), **change)  # type: ignore[arg-type]


def test_a_plan_travels_to_another_process() -> None:
    plan = TrialPlan(gait=gait_of(shipped()), belief=Failure(leg=3, kind="weak"), heading_rad=0.3)
    assert pickle.loads(pickle.dumps(plan)) == plan  # noqa: S301  our own bytes


@pytest.mark.parametrize("kind", FAILURE_KINDS)
def test_a_leg_is_held_by_the_controller_when_it_is_locked_or_nothing_more_is_known(kind: str) -> None:
    plan = TrialPlan(gait=gait_of(shipped()), belief=Failure(leg=3, kind=kind))
    assert plan.held_legs == ((3,) if kind in ("locked", "unknown") else ())


def test_a_body_that_has_turned_walks_the_same_way_in_the_world() -> None:
    plan = TrialPlan(gait=gait_of(shipped()), heading_rad=0.5, turn_rate_rad_s=0.1)
    motion = plan.motion(yaw_rad=1.2)
    assert motion.heading_rad == pytest.approx(0.5 - 1.2)
    assert (motion.travel, motion.turn_rate_rad_s) == (1.0, 0.1)


@pytest.mark.parametrize(
    ("asked", "hold", "chosen_gait", "suited"),
    [
        ("auto", "line", True, "none"),
        ("auto", "auto", True, "none"),
        ("auto", "line", False, "rear"),
        ("auto", "heading", True, "rear"),
        ("auto", "none", True, "rear"),
        ("front", "line", True, "front"),
    ],
)
def test_a_failed_leg_is_turned_to_the_rear_but_for_a_chosen_gait_on_its_line(
    asked: str, hold: str, chosen_gait: bool, suited: str
) -> None:
    assert suited_rotation(asked, hold, chosen_gait=chosen_gait) == suited


def test_a_plan_may_be_told_of_several_failed_legs() -> None:
    limp, locked = Failure(leg=6, kind="limp"), Failure(leg=2)
    plan = TrialPlan(gait=gait_of(shipped()), belief=limp, further_failures=(locked,))
    assert plan.failures == (locked, limp)
    assert (plan.failed_legs, plan.held_legs) == ((2, 6), (2,))
    with pytest.raises(InputError, match=r"further_failures: got legs 2, 2; allowed: each leg once"):
        TrialPlan(gait=gait_of(shipped()), belief=locked, further_failures=(locked,))
    with pytest.raises(InputError, match=r"further_failures: got some without a first"):
        TrialPlan(gait=gait_of(shipped()), further_failures=(locked,))
