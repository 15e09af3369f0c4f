"""The log of a trial: every tick is kept, handed on once and in order; and the trial frame."""

import math
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl import InputError, JointTargets, MissingExtraError, Recorders, RobotState
from hexctl.backends.clock import Tick
from hexctl.control.log import TickLog
from hexctl.control.table import CHUNK_ROWS
from hexctl.control.trace import PHASES, TrialFrame
from hexctl.types import JOINT_NAMES
from tests.trials import Calling


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
    log, ticks = TickLog(), 2 * CHUNK_ROWS + 5
    for index in range(ticks):
        _record(log, index)
    expected = np.arange(ticks, dtype=float)
    assert len(log) == ticks
    np.testing.assert_array_equal(log["time_s"], 0.02 * expected)
    np.testing.assert_array_equal(log["late_s"], 1e-4 * expected)
    assert (log["work_s"] == 2e-5).all()
    for column, added in (
        ("measured_rad", 0.1),
        ("base_position_world", 0.2),
        ("wanted_rad", 0.3),
        ("commanded_rad", 0.4),
    ):
        np.testing.assert_array_equal(log[column][:, 0], expected + added)
    np.testing.assert_array_equal(log["foot_contacts"].argmax(axis=-1), expected % 6)
    for start, stop in ((0, 1), (CHUNK_ROWS - 1, CHUNK_ROWS + 1), (10, ticks), (7, 7)):
        np.testing.assert_array_equal(log.rows("time_s", start, stop), log["time_s"][start:stop])


def test_what_is_missing_is_told_and_has_no_numbers() -> None:
    log, contacts = TickLog(), []
    for index, known in enumerate((True, False, True)):
        _record(log, index, posed=known)
    for part in ("base_position_world", "base_quaternion_world"):
        assert np.isnan(log[part]).all(axis=-1).tolist() == [False, True, False]
    log, stance = TickLog(), np.zeros(18)
    for touching in (np.ones(6, dtype=bool), None, np.ones(6, dtype=bool)):
        state = RobotState(stance, 0.0, measured=True, foot_contacts=touching)
        log.record(Tick(1, 0.02), state, stance, JointTargets(stance, 0.02))
        contacts.append(log.contacts_known)
    assert contacts == [True, False, True]
    assert log["foot_contacts"].any(axis=-1).tolist() == [True, False, True]
    blind = TickLog()
    blind.record(Tick(1, 0.02), RobotState(stance, 0.0, True), stance, JointTargets(stance, 0.02))
    assert blind.to_frame()["contact_leg3"].isna().all()


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
    with pytest.raises(InputError):
        Recorders(TickLog(), TickLog())


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
    assert list(TickLog().to_frame().columns) == list(frame.columns)


def test_an_empty_log_has_columns_without_rows_and_only_the_known_ones() -> None:
    log = TickLog()
    assert log["commanded_rad"].shape == (0, 18)
    assert log.rows_of("walk") == slice(0, 0)
    assert len(log.to_frame()) == 0
    with pytest.raises(KeyError, match="time_s"):
        log["measured"]


def test_a_frame_without_pandas_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError):
        TickLog().to_frame()


near = st.floats(-20, 20)


@given(heading=st.floats(-7, 7), progress=near, left=near, x=near, y=near)
def test_a_point_ahead_and_to_the_left_has_those_coordinates(
    heading: float, progress: float, left: float, x: float, y: float
) -> None:
    frame = TrialFrame(np.array([x, y, 0.1]), heading, 0.0)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    aside = np.array([-math.sin(heading), math.cos(heading)])
    point = np.array([x, y]) + progress * ahead + left * aside
    path = frame.path(np.array([[*point, 5.0]]))
    assert path.shape == (1, 2)
    assert path[0].tolist() == pytest.approx([progress, left], abs=1e-9)
