"""The guard's speed limit holds over time, however many commands come and whenever they do."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.control.posed import connected, send
from tests.robots import shipped

STANCE = shipped().stance_angles_rad
STEP = shipped().joint_max_speed_rad_s * 0.02


def test_a_burst_within_one_period_moves_no_further_than_one_command() -> None:
    guard, servos = connected()
    for _ in range(30):
        sent = send(guard, STANCE + 1.0)
        servos.time.work(0.0006)
    np.testing.assert_allclose(sent, STANCE + STEP)


def test_a_burst_that_swings_stays_within_one_step_to_either_side_a_step_at_a_time() -> None:
    guard, _ = connected()
    for _ in range(5):
        np.testing.assert_allclose(send(guard, STANCE + 1.0), STANCE + STEP)
        np.testing.assert_allclose(send(guard, STANCE - 1.0), STANCE, atol=1e-12)
        np.testing.assert_allclose(send(guard, STANCE - 1.0), STANCE - STEP)
        np.testing.assert_allclose(send(guard, STANCE + 1.0), STANCE, atol=1e-12)


def test_a_controller_at_twice_the_pace_does_not_move_at_twice_the_speed() -> None:
    guard, servos = connected()
    for _ in range(20):
        sent = send(guard, STANCE + 10.0)
        servos.time.work(0.01)
        guard.read()
    np.testing.assert_allclose(sent, np.minimum(STANCE + 10 * STEP, shipped().joint_upper_rad))


@given(
    bursts=st.lists(
        st.lists(st.tuples(st.floats(-4, 4), st.floats(0, 0.03)), max_size=8), min_size=1, max_size=12
    )
)
def test_whatever_is_written_whenever_the_joints_go_no_faster_than_they_may(
    bursts: list[list[tuple[float, float]]],
) -> None:
    guard, servos = connected()
    began_s = servos.time.now_s
    for burst in bursts:
        for wanted, pause_s in burst:
            sent = send(guard, np.full(18, wanted))
            periods = math.floor((servos.time.now_s - began_s) / 0.02 + 1e-6) + 1
            assert (np.abs(sent - STANCE) <= periods * STEP + 1e-9).all()
            servos.time.work(pause_s)
        guard.clock.tick()


def test_ticks_that_come_late_are_clipped_no_more_than_ticks_on_time() -> None:
    """A late tick and the next one on time are nearer to one another than a period."""
    guard, servos = connected()
    direction = np.where(shipped().joint_upper_rad > STANCE + 6 * STEP, 0.99, -0.99)
    for step in range(1, 7):
        servos.time.work(0.017 if step % 2 else 0.001)
        wanted = STANCE + step * direction * STEP
        np.testing.assert_array_equal(send(guard, wanted), wanted)
        guard.clock.tick()
    assert guard.counters.clipped == 0


def test_where_the_joints_are_is_asked_once_and_is_then_what_was_accepted() -> None:
    guard, servos = connected()
    np.testing.assert_array_equal(guard.accepted_rad(), STANCE)
    sent = send(guard, STANCE + 1.0)
    servos.joints_rad = STANCE - 0.5  # a measurement that lags behind
    np.testing.assert_array_equal(guard.accepted_rad(), sent)
