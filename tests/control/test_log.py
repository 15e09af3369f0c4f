"""The log of a trial: every tick is kept, handed on once and in order."""

import sys
from typing import Any

import numpy as np
import pytest

from hexctl.backends.clock import Tick
from hexctl.control.log import Recorders, TickLog
from hexctl.control.table import CHUNK_ROWS
from hexctl.control.trace import PHASES
from hexctl.errors import InputError, MissingExtraError
from hexctl.types import JOINT_NAMES, JointTargets, RobotState
from tests.recorders import Calling


def _record(log: TickLog | Recorders, index: int, *, posed: bool = True) -> None:
    state = RobotState(
        np.full(18, index + 0.1),
        0.02 * index,
        measured=True,
        base_position_world=np.full(3, index + 0.2) if posed else None,
        base_quaternion_world=np.array([1.0, 0.0, 0.0, 0.0]) if posed else None,
        foot_contacts=np.arange(6) == index % 6,
    )
    sent = JointTargets(np.full(18, index + 0.4), 0.02 * index)
    log.record(Tick(index, 0.02 * index, 1e-4 * index), state, np.full(18, index + 0.3), sent)
    log.took(2e-5)


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
        ("commanded_rad", 0.4),
    ):
        np.testing.assert_array_equal(log[column][:, 0], expected + added)
    np.testing.assert_array_equal(log["foot_contacts"].argmax(axis=-1), expected % 6)


@pytest.mark.parametrize("total", [0, 1, 99, 100, 101, 2500])
def test_blocks_are_handed_on_once_and_in_order(total: int) -> None:
    blocks: list[np.ndarray] = []
    kept = Calling(lambda log, first, last: blocks.append(log["time_s"][first:last].copy()), block_ticks=100)
    recorders = Recorders(kept)
    for index in range(total):
        _record(recorders, index)
        assert sum(map(len, blocks)) == (index + 1) // 100 * 100
    recorders.flush()
    recorders.flush()
    together = np.concatenate([np.zeros(0), *blocks])
    np.testing.assert_array_equal(together, 0.02 * np.arange(total))


def test_phases_are_found_again() -> None:
    log = TickLog()
    for phase, ticks in zip(PHASES, (3, 0, 5, 2), strict=True):
        log.phase = phase
        for _ in range(ticks):
            _record(log, 0)
    assert [log.rows_of(phase) for phase in PHASES] == [slice(0, 3), slice(0, 0), slice(3, 8), slice(8, 10)]


def test_a_pose_that_is_missing_is_told_and_has_no_numbers() -> None:
    log = TickLog()
    known = []
    for index, posed in enumerate((True, False, True)):
        _record(log, index, posed=posed)
        known.append(log.pose_known)
    assert known == [True, False, True]
    assert np.isnan(log["base_position_world"]).all(axis=-1).tolist() == [False, True, False]
    assert np.isnan(log["base_quaternion_world"]).all(axis=-1).tolist() == [False, True, False]


@pytest.mark.parametrize("part", ["base_position_world", "base_quaternion_world"])
def test_half_a_pose_is_kept(part: str) -> None:
    log, stance = TickLog(), np.zeros(18)
    value = np.array([0.1, 0.2, 0.3] if part == "base_position_world" else [0.6, 0.0, 0.0, 0.8])
    pose: dict[str, Any] = {part: value}
    log.record(Tick(1, 0.02), RobotState(stance, 0.0, True, **pose), stance, JointTargets(stance, 0.02))
    np.testing.assert_array_equal(log[part], [value])
    (other,) = {"base_position_world", "base_quaternion_world"} - {part}
    assert np.isnan(log[other]).all()
    assert log.pose_known == (part == "base_position_world")


def test_rows_are_the_same_across_chunks() -> None:
    log = TickLog()
    for index in range(2 * CHUNK_ROWS + 5):
        _record(log, index)
    whole = log["time_s"]
    for start, stop in ((0, 1), (CHUNK_ROWS - 1, CHUNK_ROWS + 1), (10, 2 * CHUNK_ROWS + 5), (7, 7)):
        np.testing.assert_array_equal(log.rows("time_s", start, stop), whole[start:stop])


def test_the_work_of_a_tick_is_kept_with_it() -> None:
    log = TickLog()
    for index in range(3):
        _record(log, index)
    assert log["work_s"].tolist() == [2e-5] * 3


@pytest.mark.parametrize("fails", ["first", "last"])
def test_a_recorder_that_fails_is_left_out_and_silences_no_other(fails: str) -> None:
    calls: list[int] = []
    rows: list[tuple[int, int]] = []

    def fail(_: TickLog, first: int, __: int) -> None:
        calls.append(first)
        raise OSError("disk full")

    failing = Calling(fail, block_ticks=2)
    whole = Calling(lambda _, first, last: rows.append((first, last)))
    both = (failing, whole) if fails == "first" else (whole, failing)
    recorders = Recorders(*both, block_ticks=3)
    for index in range(7):
        _record(recorders, index)
    recorders.flush()
    assert calls == [0]
    assert rows == [(0, 3), (3, 6), (6, 7)]
    assert str(recorders.error_of(failing)) == "disk full"
    assert recorders.error_of(whole) is None
    assert [failure.recorder for failure in recorders.failures] == [failing]
    assert len(recorders.log) == 7


def test_each_recorder_has_blocks_of_its_own_size() -> None:
    sizes: dict[int, list[int]] = {2: [], 5: []}
    given = [
        Calling(lambda _, first, last, size=size: sizes[size].append(last - first), block_ticks=size)  # type: ignore[misc]
        for size in sizes
    ]
    log = TickLog()
    recorders = Recorders(log, *given)
    for index in range(11):
        _record(recorders, index)
    recorders.flush()
    assert sizes == {2: [2, 2, 2, 2, 2, 1], 5: [5, 5, 1]}
    assert recorders.log is log
    assert len(log) == 11


def test_two_logs_are_refused() -> None:
    with pytest.raises(InputError, match="got 2 logs; allowed: one"):
        Recorders(TickLog(), TickLog())


def test_contacts_that_are_missing_are_told_and_are_no_touch() -> None:
    log, stance = TickLog(), np.zeros(18)
    known = []
    for contacts in (np.ones(6, dtype=bool), None, np.ones(6, dtype=bool)):
        state = RobotState(stance, 0.0, measured=True, foot_contacts=contacts)
        log.record(Tick(1, 0.02), state, stance, JointTargets(stance, 0.02))
        known.append(log.contacts_known)
    assert known == [True, False, True]
    assert log["foot_contacts"].any(axis=-1).tolist() == [True, False, True]


def test_the_ticks_of_the_walk_are_counted() -> None:
    log = TickLog()
    for phase, ticks in zip(PHASES, (3, 2, 5, 4), strict=True):
        log.phase = phase
        for _ in range(ticks):
            _record(log, 0)
    assert log.walked_ticks == 5


def test_an_empty_log_has_columns_without_rows() -> None:
    log = TickLog()
    assert log["commanded_rad"].shape == (0, 18)
    assert log["time_s"].shape == (0,)
    assert log.rows_of("walk") == slice(0, 0)


def test_a_log_is_not_changed_by_what_happens_to_the_messages_later() -> None:
    log, wanted = TickLog(), np.zeros(18)
    state = RobotState(wanted, 0.0, measured=True)
    log.record(Tick(1, 0.02), state, wanted, JointTargets(wanted, 0.02))
    wanted[:] = 9
    assert (log["measured_rad"] == 0).all()
    assert (log["wanted_rad"] == 0).all()
    assert (log["commanded_rad"] == 0).all()


def test_a_frame_has_a_row_per_tick_and_a_column_per_joint() -> None:
    log = TickLog()
    for index in range(4):
        log.phase = PHASES[0] if index < 2 else "walk"
        _record(log, index + 10, posed=index != 1)
    frame = log.to_frame()
    assert frame["time_s"].tolist() == pytest.approx([0.0, 0.02, 0.04, 0.06])
    assert frame["walk_s"].tolist() == pytest.approx([0.0, 0.0, 0.0, 0.02])
    assert frame["phase"].tolist() == [PHASES[0]] * 2 + ["walk"] * 2
    for column, name in (
        ("measured_rad", "measured"),
        ("commanded_rad", "commanded"),
        ("wanted_rad", "wanted"),
    ):
        for joint in ("leg1_coxa", "leg4_tibia"):
            place = JOINT_NAMES.index(joint)
            np.testing.assert_array_equal(frame[f"{name}_{joint}_rad"], log[column][:, place])
    assert frame["base_y_m"].isna().tolist() == [False, True, False, False]
    assert frame["contact_leg6"].tolist() == [(index + 10) % 6 == 5 for index in range(4)]
    assert frame["torque_leg2_femur_nm"].isna().all()
    assert repr(log) == "TickLog(4 ticks, 0.06 s)"


def test_a_frame_of_an_empty_log_has_all_columns() -> None:
    log = TickLog()
    _record(log, 0)
    assert list(TickLog().to_frame().columns) == list(log.to_frame().columns)
    assert len(TickLog().to_frame()) == 0


def test_contacts_that_are_not_measured_are_empty_in_a_frame() -> None:
    log, stance = TickLog(), np.zeros(18)
    log.record(Tick(1, 0.02), RobotState(stance, 0.0, True), stance, JointTargets(stance, 0.02))
    assert log.to_frame()["contact_leg3"].isna().all()


def test_a_frame_without_pandas_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match=r"hexctl\[data\]"):
        TickLog().to_frame()


def test_an_unknown_column_is_answered_with_the_known_ones() -> None:
    with pytest.raises(KeyError, match=r"measured; allowed: time_s, .*measured_rad"):
        TickLog()["measured"]
