"""The speeds that a gait can be commanded to, against walks at and beyond them."""

import math

import numpy as np
import pytest

from hexctl.control.assessment.speed_envelope import DIRECTIONS_RAD, speed_envelope
from hexctl.control.controllers import check_walk
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.velocity_walk import OVERDRIVE, VelocityWalk
from hexctl.errors import LimitError, ReachError
from hexctl.gait.gait import Motion, ideal_speed_m_s, make_gait
from hexctl.types import RobotState
from tests.robots import shipped


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ant", "pexod", "phantomx"])
def test_a_shipped_robot_is_bounded_by_its_strokes_alone(name: str) -> None:
    robot = shipped(name)
    gait = make_gait(robot, "demo")
    envelope = speed_envelope(robot, gait)
    assert envelope.speeds_m_s.shape == (7, len(DIRECTIONS_RAD))
    full_m_s = OVERDRIVE * ideal_speed_m_s(robot, gait, Motion())
    assert envelope.speeds_m_s.max() == pytest.approx(full_m_s)
    assert (envelope.speeds_m_s > 0.5 * full_m_s).all()
    assert (envelope.speeds_m_s[1:] >= envelope.speeds_m_s[0]).all(), "a leg less restricts no other"
    assert (envelope.margins_m[0] > 0.02).all()
    assert (envelope.margins_m[1:] < envelope.margins_m[0]).all()
    assert set(envelope.to_dict()["speeds_m_s"]) == {"intact", "1", "2", "3", "4", "5", "6"}


@pytest.mark.slow
def test_what_it_allows_can_be_walked_and_little_more_cannot() -> None:
    robot = shipped()
    gait = make_gait(robot, "demo", amplitude=0.35)
    envelope = speed_envelope(robot, gait)
    speed_m_s, ideal_m_s = envelope.speeds_m_s[0, 0], ideal_speed_m_s(robot, gait, Motion())
    assert 0 < speed_m_s < OVERDRIVE * ideal_m_s

    def walk(share: float) -> None:
        longer = make_gait(robot, "demo", amplitude=0.35 * share)
        check_walk(robot, longer, Motion())

    walk(speed_m_s / ideal_m_s * 0.999)
    with pytest.raises((ReachError, LimitError)):
        walk(speed_m_s / ideal_m_s + 0.07)


def test_a_walk_within_it_is_not_limited_and_one_beyond_it_is() -> None:
    robot = shipped()
    gait = make_gait(robot, "demo")
    envelope = speed_envelope(robot, gait, (math.radians(30),))
    start = WalkStart(
        robot=robot, plans=(TrialPlan(gait=gait),), batch_shape=(), period_s=0.02, turned_rad=0.0, frame=None
    )
    nothing = RobotState(np.zeros(18), 0.0, True)
    for share, limited in ((0.99, False), (1.05, True)):
        speed_m_s = share * envelope.speeds_m_s[0, 0]
        velocity = speed_m_s * np.array([math.cos(math.radians(30)), math.sin(math.radians(30)), 0.0])
        walk = VelocityWalk(start, lambda *_, velocity=velocity: velocity)
        for step in range(100):
            walk.targets_rad(step, nothing)
        assert bool(walk.limited_steps > 0) is limited
