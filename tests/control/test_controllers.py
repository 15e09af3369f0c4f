"""Controllers and their loop: standing up, a walk whose look-ahead changes nothing, and what a tick does."""

import numpy as np
import pytest

from hexctl import Controller, EStopError, RobotState
from hexctl.control.controllers import LOOK_AHEAD_TICKS, Stand, Walk, soft_stop_steps
from hexctl.control.log import TickLog
from hexctl.control.loop import run_controller
from hexctl.gait.foot_trajectory import gait_feet_body
from hexctl.gait.gait import Motion
from hexctl.ik.legs import solve_legs
from hexctl.types import FloatArray
from tests.control.posed import connected
from tests.robots import ROBOT_NAMES, shipped
from tests.trials import gait_of

ANT = shipped()


STATE = RobotState(ANT.stance_angles_rad, 0.0, measured=True)


MOTION = Motion(heading_rad=0.4, travel=0.7, turn_rate_rad_s=0.1)


def _angles(walk: Walk, ticks: range) -> FloatArray:
    return np.array([walk.targets_rad(tick, STATE) for tick in ticks])


def test_standing_up_is_even_and_ends_in_the_stance() -> None:
    start = ANT.stance_angles_rad + np.linspace(-0.5, 0.5, 18)
    stand = Stand(ANT, start, 25)
    path = np.array([stand.targets_rad(tick, STATE) for tick in range(40)])
    np.testing.assert_array_equal(path[0], start)
    np.testing.assert_allclose(
        np.diff(path[:26], axis=0), (ANT.stance_angles_rad - start) / 25 + np.zeros((25, 18))
    )
    np.testing.assert_array_equal(path[25:], np.tile(ANT.stance_angles_rad, (15, 1)))


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_looking_ahead_gives_exactly_what_planning_tick_by_tick_gives(name: str) -> None:
    robot = shipped(name)
    gait = gait_of(robot)
    walk = Walk(robot, gait, MOTION, period_s=0.02)
    ticks = range(3 * LOOK_AHEAD_TICKS + 7)
    expected = [
        solve_legs(robot, gait_feet_body(robot, gait, MOTION, tick * 0.02)).joint_positions_rad
        for tick in ticks
    ]
    assert np.array_equal(_angles(walk, ticks), expected)
    for tick in (0, 1, 5, 5, 130, 2, 390, 127, 128, 129):  # missed, or asked for again
        assert np.array_equal(walk.targets_rad(tick, STATE), expected[tick])


@pytest.mark.parametrize("stop_tick", [0, 1, 128, 333])
def test_a_stop_goes_on_from_the_stride_and_ends_in_the_stance(stop_tick: int) -> None:
    plain = Walk(ANT, gait_of(ANT), MOTION, period_s=0.02)
    walk = Walk(ANT, gait_of(ANT), MOTION, period_s=0.02)
    for tick in range(stop_tick):
        assert np.array_equal(walk.targets_rad(tick, STATE), plain.targets_rad(tick, STATE))
    walk.stop(stop_tick)
    walk.stop(stop_tick + 50)  # a second stop changes nothing
    end = stop_tick + soft_stop_steps(0.02)
    angles = _angles(walk, range(max(0, stop_tick - 1), end + 20))
    np.testing.assert_allclose(
        angles[end - max(0, stop_tick - 1) :], ANT.stance_angles_rad + np.zeros((20, 18)), atol=1e-12
    )
    fastest = np.abs(np.diff(_angles(plain, range(100, 300)), axis=0)).max()
    assert np.abs(np.diff(angles, axis=0)).max() <= fastest + 0.01, "no jump"


# The loop: read, think, guard, write, record, on the clock's time


class _Nudge(Controller):
    """Asks for the stance and a little more each step."""

    def __init__(self, stance_rad: FloatArray) -> None:
        self._stance_rad = stance_rad
        self.asked: list[tuple[int, float]] = []

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        self.asked.append((step, float(state.joint_positions_rad[0])))
        return self._stance_rad + 0.01 * step


def test_each_tick_reads_what_the_last_one_wrote_and_is_recorded() -> None:
    (guard, servos), controller, log = connected(), _Nudge(ANT.stance_angles_rad), TickLog()
    last, state = run_controller(guard, controller, (log,), until=lambda step, _: step >= 9)
    assert last == 9
    assert [step for step, _ in controller.asked] == list(range(10))
    stance = float(ANT.stance_angles_rad[0])
    np.testing.assert_allclose(
        [joint for _, joint in controller.asked], [stance, *(stance + 0.01 * step for step in range(9))]
    )
    assert [sent.stamp_s for sent in servos.sent] == log["time_s"].tolist()
    np.testing.assert_array_equal(log["commanded_rad"], log["requested_rad"])
    np.testing.assert_array_equal(log["measured_rad"][-1], state.joint_positions_rad)
    assert state.stamp_s == pytest.approx(log["time_s"][-1])
    assert (log["work_s"] >= 0).all()


def test_steps_follow_the_clock_over_points_that_it_skips() -> None:
    (guard, servos), controller, log = connected(), _Nudge(ANT.stance_angles_rad), TickLog()

    def slow(step: int, _: RobotState) -> bool:
        servos.time.work(0.02 * 3.5)
        return step >= 12

    last, _ = run_controller(guard, controller, (log,), until=slow)
    steps = [step for step, _ in controller.asked]
    assert steps == sorted(set(steps))
    assert len(steps) < 7
    ticks = (log["time_s"] - log["time_s"][0]) / 0.02
    assert ticks == pytest.approx(steps)
    assert last == steps[-1]


def test_a_stop_ends_the_drive_before_the_servos_hear_of_it() -> None:
    (guard, servos), controller, log = connected(), _Nudge(ANT.stance_angles_rad), TickLog()

    def press(step: int, _: RobotState) -> bool:
        if step == 3:
            guard.stop("by hand")
        return False

    with pytest.raises(EStopError):
        run_controller(guard, controller, (log,), until=press)
    assert len(servos.sent) == len(log) == 4
