"""The filter's mathematics: its Jacobians against differences, and what it learns."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.estimation.pose_belief import POSE, STATES, OwnMotion, PoseBelief, Sighting

MEAN = np.array([0.3, -0.2, 0.8, 0.1, -0.05, 0.1, 0.2, 0.1, -0.03, 0.4])


def belief(mean: np.ndarray = MEAN) -> PoseBelief:
    return PoseBelief(0.0, mean.copy(), np.diag(np.arange(1.0, STATES + 1)) * 1e-8)


def stepped(start: PoseBelief, how: str) -> PoseBelief:
    if how == "coasted":
        return start.coasted(0.3, 0.5)
    own = OwnMotion(0.0, 0.2, np.array([0.02, -0.01, 0.1]), yaw_measured=how == "measured")
    return start.moved(own, 0.2)


@pytest.mark.parametrize("how", ["moved", "measured", "coasted"])
def test_covariances_follow_the_derivatives_of_the_step(how: str) -> None:
    start, tiny = belief(), 1e-6
    columns = [
        stepped(replace(start, mean=MEAN + way), how).mean
        - stepped(replace(start, mean=MEAN - way), how).mean
        for way in tiny * np.eye(STATES)
    ]
    jacobian = np.column_stack(columns) / (2 * tiny)
    if how != "coasted":
        jacobian[7:] = 0.0  # the velocity is only shown by odometry, and not followed
    noise = stepped(replace(start, covariance=np.zeros((STATES, STATES))), how).covariance
    expected = jacobian @ start.covariance @ jacobian.T + noise
    assert stepped(start, how).covariance == pytest.approx(expected, rel=1e-4, abs=1e-14)


def test_parts_of_a_motion_are_the_whole() -> None:
    own = OwnMotion(0.0, 0.2, np.array([0.02, 0.0, 0.0]))
    parts = belief().moved(own, 0.05).moved(own, 0.2)
    assert parts.mean[POSE] == pytest.approx(belief().moved(own, 0.2).mean[POSE], abs=1e-3)
    assert parts.at_s == 0.2


def test_a_step_of_odometry_that_is_off_does_not_turn_the_velocity_round() -> None:
    """Where the weight goes from feet to feet, one step is off by its own length: it coasts on ahead."""
    now = belief(np.zeros(STATES))
    for tick, forward_m in enumerate([0.004] * 20 + [-0.004]):
        now = now.moved(OwnMotion(0.02 * tick, 0.02 * (tick + 1), np.array([forward_m, 0.0, 0.0])), 0.42)
    assert 0.05 < now.mean[7] < 0.2
    stopped = now
    for tick in range(21, 36):
        stopped = stopped.moved(OwnMotion(0.02 * tick, 0.02 * (tick + 1), np.zeros(3)), 0.72)
    assert abs(stopped.mean[7]) < 0.002


def test_slip_is_learned() -> None:
    spread = np.diag([1e-6, 1e-6, 1e-6])
    at_first = PoseBelief.of(Sighting(0.0, PlanarPose(0, 0, 0), spread))
    now = at_first
    for tick in range(200):
        own = OwnMotion(0.02 * tick, 0.02 * (tick + 1), np.array([0.004, 0.0, 0.0]))
        now = now.moved(own, own.to_s)
        now = now.after(Sighting(own.to_s, PlanarPose(0.9 * 0.004 * (tick + 1), 0, 0), spread))
    assert now.mean[3] == pytest.approx(-0.1, abs=0.03)
    assert now.covariance[3, 3] < at_first.covariance[3, 3] / 4
    assert now.surprise(Sighting(4.0, PlanarPose(0.72, 0, 0), spread)) < 2
    assert now.surprise(Sighting(4.0, PlanarPose(0.82, 0, 0), spread)) > 5
