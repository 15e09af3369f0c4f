"""The tick: read, think, guard, write, record, in this order and on the clock's time."""

import numpy as np
import pytest

from hexctl import Controller, EStopError, Guard, JointTargets, RobotState
from hexctl.backends.clock import Tick
from hexctl.control.loop import run_controller
from hexctl.types import FloatArray
from tests.control.posed import PosedMock


class _Nudge(Controller):
    """Asks for the stance and a little more each step."""

    def __init__(self, stance_rad: FloatArray) -> None:
        self._stance_rad = stance_rad
        self.asked: list[tuple[int, float]] = []

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        self.asked.append((step, float(state.joint_positions_rad[0])))
        return self._stance_rad + 0.01 * step


class _Rows:
    """Keeps what is recorded."""

    def __init__(self) -> None:
        self.rows: list[tuple[Tick, RobotState, FloatArray, JointTargets]] = []
        self.work_s: list[float] = []

    def record(self, tick: Tick, state: RobotState, wanted_rad: FloatArray, sent: JointTargets) -> None:
        self.rows.append((tick, state, wanted_rad, sent))

    def took(self, work_s: float) -> None:
        self.work_s.append(work_s)


def _connected() -> tuple[Guard, PosedMock, _Nudge, _Rows]:
    servos = PosedMock()
    servos.connect()
    return Guard(servos), servos, _Nudge(servos.robot.stance_angles_rad), _Rows()


def test_each_tick_reads_what_the_last_one_wrote_and_is_recorded() -> None:
    guard, servos, controller, rows = _connected()
    last, state = run_controller(guard, controller, (rows,), until=lambda step, _: step >= 9)
    stance = float(servos.robot.stance_angles_rad[0])
    assert last == 9
    assert [step for step, _ in controller.asked] == list(range(10))
    read = [stance, *(stance + 0.01 * step for step in range(9))]
    np.testing.assert_allclose([joint for _, joint in controller.asked], read)
    assert len(rows.rows) == len(servos.sent) == 10
    for tick, recorded, wanted, sent in rows.rows:
        assert sent.stamp_s == tick.time_s
        np.testing.assert_array_equal(sent.joint_positions_rad, wanted)
        assert recorded.stamp_s == pytest.approx(tick.time_s)
    assert rows.rows[-1][1] is state
    assert len(rows.work_s) == 10
    assert all(work_s >= 0 for work_s in rows.work_s)


def test_steps_follow_the_clock_over_points_that_it_skips() -> None:
    guard, servos, controller, rows = _connected()

    def slow(step: int, _: RobotState) -> bool:
        servos.time.work(0.02 * 3.5)
        return step >= 12

    last, _ = run_controller(guard, controller, (rows,), until=slow)
    steps = [step for step, _ in controller.asked]
    assert steps == sorted(set(steps))
    assert len(steps) < 7
    assert [tick.index - rows.rows[0][0].index for tick, *_ in rows.rows] == steps
    assert last == steps[-1]


def test_a_stop_ends_the_drive_before_the_servos_hear_of_it() -> None:
    guard, servos, controller, rows = _connected()

    def press(step: int, _: RobotState) -> bool:
        if step == 3:
            guard.stop("by hand")
        return False

    with pytest.raises(EStopError):
        run_controller(guard, controller, (rows,), until=press)
    assert len(servos.sent) == len(rows.rows) == 4
