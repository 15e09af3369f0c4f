"""The log of a trial: every tick is kept, handed on once and in order."""

import numpy as np
import pytest

from hexctl.backends.clock import Tick
from hexctl.control.log import PHASES, TickLog
from hexctl.robot.messages import JointTargets, RobotState


def _record(log: TickLog, index: int, *, posed: bool = True) -> None:
    state = RobotState(
        np.full(18, index + 0.1),
        0.02 * index,
        measured=True,
        base_position_world=np.full(3, index + 0.2) if posed else None,
        base_quaternion_world=np.array([1.0, 0.0, 0.0, 0.0]) if posed else None,
        foot_contacts=np.arange(6) == index % 6,
    )
    sent = JointTargets(np.full(18, index + 0.4), 0.02 * index)
    log.record(Tick(index, 0.02 * index, 1e-4 * index), state, np.full(18, index + 0.3), sent, 2e-5)


def test_every_tick_is_kept_as_it_came_however_many_there_are() -> None:
    log = TickLog()
    for index in range(5000):
        _record(log, index)
    expected = np.arange(5000.0)
    assert len(log) == 5000
    np.testing.assert_array_equal(log["time_s"], 0.02 * expected)
    np.testing.assert_array_equal(log["late_s"], 1e-4 * expected)
    for column, added in (
        ("measured_rad", 0.1),
        ("base_position_world", 0.2),
        ("wanted_rad", 0.3),
        ("sent_rad", 0.4),
    ):
        np.testing.assert_array_equal(log[column][:, 0], expected + added)
    np.testing.assert_array_equal(log["foot_contacts"].argmax(axis=-1), expected % 6)


@pytest.mark.parametrize("total", [0, 1, 99, 100, 101, 2500])
def test_blocks_are_handed_on_once_and_in_order(total: int) -> None:
    blocks: list[np.ndarray] = []
    log = TickLog(lambda log, first, last: blocks.append(log["time_s"][first:last].copy()), block_ticks=100)
    for index in range(total):
        _record(log, index)
        assert sum(map(len, blocks)) == (index + 1) // 100 * 100
    log.flush()
    log.flush()
    together = np.concatenate([np.zeros(0), *blocks])
    np.testing.assert_array_equal(together, 0.02 * np.arange(total))


def test_phases_are_found_again() -> None:
    log = TickLog()
    for phase, ticks in zip(PHASES, (3, 0, 5, 2), strict=True):
        log.phase = phase
        for _ in range(ticks):
            _record(log, 0)
    assert [log.rows_of(phase) for phase in PHASES] == [slice(0, 3), slice(0, 0), slice(3, 8), slice(8, 10)]


def test_a_pose_that_was_missing_once_is_told() -> None:
    log = TickLog()
    _record(log, 0)
    assert log.pose_known
    _record(log, 1, posed=False)
    _record(log, 2)
    assert not log.pose_known


def test_a_log_is_not_changed_by_what_happens_to_the_messages_later() -> None:
    log, wanted = TickLog(), np.zeros(18)
    state = RobotState(wanted, 0.0, measured=True)
    log.record(Tick(1, 0.02), state, wanted, JointTargets(wanted, 0.02), 0.0)
    wanted[:] = 9
    assert (log["measured_rad"] == 0).all()
    assert (log["wanted_rad"] == 0).all()
    assert (log["sent_rad"] == 0).all()
