"""Tests for every `LegServos`."""

import itertools
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import FrameType

import numpy as np
import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.clock import PERIOD_S
from hexctl.columns import SENSED
from hexctl.control.guard import Guard
from hexctl.errors import CommandRefusedError, RobotFaultError
from hexctl.types import N_JOINTS, N_LEGS, FloatArray, JointTargets, RobotState
from hexctl.waiting import comes_true

TICKS_PER_SECOND = round(1 / PERIOD_S)


class LegServosConformance:
    """The suite: inherit it, name the class `Test...` and define how to make servos.

    On a wall clock it takes about twenty seconds, and the joints move by up to 0.1 rad about the stance: hold
    a real robot off the floor.

    Attributes:
        tolerance_rad: how far an idle joint may rest from its target under the robot's own weight.
    """

    tolerance_rad = 0.03

    def make(self) -> LegServos:
        """Fresh unconnected servos."""
        raise NotImplementedError("make: returns your servos, not connected")

    @pytest.fixture
    def fresh(self) -> Iterator[LegServos]:
        """Unconnected servos, closed at the end."""
        servos = self.make()
        yield servos
        servos.close()

    @pytest.fixture
    def servos(self, fresh: LegServos) -> LegServos:
        """Connected servos."""
        fresh.connect()
        return fresh

    def test_robot_and_clock_are_readable_before_connecting(self, fresh: LegServos) -> None:
        """Robot and clock can be read before the servos are connected."""
        assert fresh.robot.stance_angles_rad.shape == (N_JOINTS,)
        assert fresh.clock.period_s == PERIOD_S
        assert fresh.clock.overruns == 0

    def test_nothing_is_read_or_written_before_connecting(self, fresh: LegServos) -> None:
        """`read` and `write` raise RobotFaultError that names `connect` before it was called."""
        with pytest.raises(RobotFaultError, match="connect"):
            fresh.read()
        with pytest.raises(RobotFaultError, match="connect"):
            fresh.write(JointTargets(fresh.robot.stance_angles_rad, 0.0))

    def test_connecting_twice_changes_nothing(self, servos: LegServos) -> None:
        """A second `connect` moves nothing and loses no state."""
        move(servos, servos.robot.stance_angles_rad + 0.02, ticks=TICKS_PER_SECOND)
        before = servos.read()
        servos.connect()
        np.testing.assert_array_equal(servos.read().joint_positions_rad, before.joint_positions_rad)

    def test_closing_twice_or_before_connecting_changes_nothing(self, fresh: LegServos) -> None:
        """`close` may come before `connect` and twice; then `read` and `write` are refused."""
        fresh.close()
        fresh.connect()
        fresh.close()
        fresh.close()
        with pytest.raises(RobotFaultError, match="connect"):
            fresh.read()
        with pytest.raises(RobotFaultError, match="connect"):
            fresh.write(JointTargets(fresh.robot.stance_angles_rad, fresh.clock.now_s))

    def test_a_with_statement_connects_and_closes(self, fresh: LegServos) -> None:
        """A with statement connects at its begin and closes at its end."""
        with fresh as entered:
            assert entered is fresh
            assert fresh.read().joint_positions_rad.shape == (N_JOINTS,)
        with pytest.raises(RobotFaultError):
            fresh.read()

    def test_a_with_statement_closes_after_an_error_and_lets_it_through(self, fresh: LegServos) -> None:
        """A with statement closes after an error in its block, which it passes on."""
        with pytest.raises(ZeroDivisionError), fresh:
            raise ZeroDivisionError
        with pytest.raises(RobotFaultError):
            fresh.read()

    def test_after_closing_the_robot_can_be_reached_again(self, servos: LegServos) -> None:
        """Closed servos can be connected again; their clock's ticks continue to grow."""
        move(servos, servos.robot.stance_angles_rad + 0.02, ticks=10)
        last = servos.clock.tick()
        servos.close()
        servos.connect()
        tick = servos.clock.tick()
        assert tick.index > last.index
        assert servos.clock.index == tick.index, "a state is read once per `index` of the clock"
        check_state(servos.read(), servos)
        self.check_reaches(servos, servos.robot.stance_angles_rad - 0.02)

    @pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.99])
    def test_interrupted_connecting_leaves_nothing_behind(self, fresh: LegServos, share: float) -> None:
        """If `connect` is interrupted on its way, `close` releases everything, and a new `connect` works."""
        fresh.connect()  # what is loaded once is loaded now
        fresh.close()
        calls = calls_of(fresh.connect)
        fresh.close()
        threads = set(threading.enumerate())
        with suppress(KeyboardInterrupt):
            calls_of(fresh.connect, int(share * calls))
        fresh.close()
        assert comes_true(lambda: set(threading.enumerate()) <= threads, 5.0)
        with pytest.raises(RobotFaultError, match="connect"):
            fresh.read()
        fresh.connect()
        self.check_reaches(fresh, fresh.robot.stance_angles_rad + 0.02)

    def test_ticks_lie_on_a_grid_and_grow(self, servos: LegServos) -> None:
        """Ticks grow, lie at multiples of the control period, and are never early; nor is `now_s`."""
        ticks = []
        for _ in range(20):
            ticks.append(servos.clock.tick())
            assert servos.clock.now_s >= ticks[-1].time_s - 1e-9
            hold(servos)
        assert all(after.index > before.index for before, after in itertools.pairwise(ticks))
        for tick in ticks:
            assert tick.time_s == pytest.approx(tick.index * PERIOD_S, abs=1e-9)
            assert tick.late_s >= 0

    def test_a_state_has_the_shapes_that_it_promises(self, servos: LegServos) -> None:
        """A state has the shapes, types and ranges that `RobotState` documents."""
        check_state(servos.read(), servos)
        servos.clock.tick()
        check_state(servos.read(), servos)

    def test_reading_again_within_a_tick_changes_nothing(self, servos: LegServos) -> None:
        """Reading again within a tick gives the same state and takes no control period."""
        tick, skipped = servos.clock.tick(), servos.clock.overruns
        hold(servos)
        first = servos.read()
        for _ in range(5):
            again = servos.read()
            np.testing.assert_array_equal(again.joint_positions_rad, first.joint_positions_rad)
        assert servos.clock.tick().index == tick.index + 1 + servos.clock.overruns - skipped

    def test_a_state_is_not_changed_by_what_comes_later(self, servos: LegServos) -> None:
        """The arrays of a state stay as they are when the robot moves on."""
        state = servos.read()
        kept = [None if array is None else array.copy() for array in arrays_of(state)]
        move(servos, servos.robot.stance_angles_rad + 0.02, ticks=20)
        for array, copy in zip(arrays_of(state), kept, strict=True):
            np.testing.assert_array_equal(array, copy)

    def test_writing_into_a_state_does_not_change_the_robot(self, servos: LegServos) -> None:
        """The arrays of a state are the caller's: writing into them moves nothing."""
        state, expected = servos.read(), servos.read()
        for array in arrays_of(state):
            if array is not None:
                array[:] = 1
        for array, untouched in zip(arrays_of(servos.read()), arrays_of(expected), strict=True):
            np.testing.assert_array_equal(array, untouched)

    def test_messages_are_counted(self, servos: LegServos) -> None:
        """`link_counts` holds whole numbers, which the guard passes on."""
        servos.clock.tick()
        servos.read()
        assert all(isinstance(n, int) and n >= 0 for n in servos.link_counts.values())
        assert Guard(servos).link_counts == servos.link_counts

    def test_write_returns_what_was_sent(self, servos: LegServos) -> None:
        """`write` returns the targets actually sent."""
        servos.clock.tick()
        target_rad = servos.robot.stance_angles_rad + 0.01
        sent = servos.write(JointTargets(target_rad, servos.clock.now_s))
        np.testing.assert_array_equal(sent.joint_positions_rad, target_rad)

    def test_targets_are_taken_over_when_they_are_written(self, servos: LegServos) -> None:
        """An array of targets may be changed by its owner once `write` is over."""
        target_rad = servos.robot.stance_angles_rad + 0.02
        mine = target_rad.copy()
        for _ in range(TICKS_PER_SECOND):
            servos.clock.tick()
            mine[:] = target_rad
            servos.write(JointTargets(mine, servos.clock.now_s))
            mine[:] = 0.3
        reached = servos.read().joint_positions_rad
        np.testing.assert_allclose(reached, target_rad, atol=self.tolerance_rad)

    def test_a_small_change_is_reached_within_a_second(self, servos: LegServos) -> None:
        """Each joint is within `tolerance_rad` of a target near its stance after a second."""
        self.check_reaches(servos, servos.robot.stance_angles_rad + np.tile([0.1, -0.06, 0.06], N_LEGS))
        self.check_reaches(servos, servos.robot.stance_angles_rad + np.tile([-0.1, 0.06, -0.06], N_LEGS))

    def test_targets_that_are_not_finite_are_refused(self, servos: LegServos) -> None:
        """Targets with NaN or infinity are refused with CommandRefusedError, and nothing moves."""
        stance_rad = servos.robot.stance_angles_rad
        spoiled = [stance_rad + 0.1 for _ in range(6)]
        for target_rad, (bad, joint) in zip(
            spoiled, itertools.product((np.nan, np.inf, -np.inf), (0, N_JOINTS - 1)), strict=True
        ):
            target_rad[joint] = bad
        self.check_refused(servos, spoiled)

    def test_targets_of_another_shape_are_refused(self, servos: LegServos) -> None:
        """Targets of another shape than (18,) are refused with CommandRefusedError, and nothing moves."""
        shapes: list[tuple[int, ...]] = [(), (0,), (N_JOINTS - 1,), (N_JOINTS + 1,), (6, 3), (1, N_JOINTS)]
        self.check_refused(servos, [np.full(shape, 0.1) for shape in shapes])

    def check_refused(self, servos: LegServos, spoiled: list[FloatArray]) -> None:
        """Check that targets are refused in one line each, that nothing moves, and that good ones pass."""
        move(servos, servos.robot.stance_angles_rad, ticks=TICKS_PER_SECOND)
        for target_rad in spoiled:
            before = servos.read().joint_positions_rad
            with pytest.raises(CommandRefusedError, match=r"targets: got .*; allowed: ") as refused:
                servos.write(JointTargets(target_rad, servos.clock.now_s))
            assert "\n" not in str(refused.value)
            for _ in range(5):
                servos.clock.tick()
            after = servos.read().joint_positions_rad
            np.testing.assert_allclose(after, before, atol=3e-3, err_msg=f"after {target_rad}")
            hold(servos)
        self.check_reaches(servos, servos.robot.stance_angles_rad + 0.02)

    def check_reaches(self, servos: LegServos, target_rad: FloatArray) -> None:
        """Check that the joints reach their targets within a second."""
        move(servos, target_rad, ticks=TICKS_PER_SECOND)
        servos.clock.tick()
        np.testing.assert_allclose(servos.read().joint_positions_rad, target_rad, atol=self.tolerance_rad)


def calls_of(function: Callable[[], object], interrupt_at: int = -1) -> int:
    """Number of calls in a function, of which one is interrupted, as by Ctrl-C; but none of locks."""
    count = itertools.count()

    def profile(frame: FrameType, event: str, _argument: object) -> None:
        of_locks = frame.f_globals.get("__name__") == "threading"
        if event == "call" and not of_locks and next(count) == interrupt_at:
            raise KeyboardInterrupt

    sys.setprofile(profile)
    try:
        function()
    finally:
        sys.setprofile(None)
    return next(count)


def move(servos: LegServos, target_rad: FloatArray, *, ticks: int) -> None:
    """Command the same targets for some ticks."""
    for _ in range(ticks):
        servos.clock.tick()
        servos.write(JointTargets(target_rad, servos.clock.now_s))


def hold(servos: LegServos) -> None:
    """Command the stance once."""
    servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))


def arrays_of(state: RobotState) -> list[FloatArray | None]:
    """The arrays of a state, numbers as (1,)."""
    values = [getattr(state, column.source) for column in SENSED]
    return [None if one is None else np.atleast_1d(one) for one in values]


def check_state(state: RobotState, servos: LegServos) -> None:
    """Check shapes, types and ranges of a state."""
    assert state.joint_positions_rad.shape == (N_JOINTS,)
    assert np.isfinite(state.joint_positions_rad).all()
    assert isinstance(state.measured, bool)
    assert state.healthy
    assert state.age_s >= 0
    assert 0 <= state.stamp_s <= servos.clock.now_s + 1e-9
    for column in SENSED:
        if (values := getattr(state, column.source)) is not None:
            assert np.shape(values) == column.shape, column.name
            assert np.asarray(values).dtype == column.kind, column.name
    if state.base_quaternion_world is not None:
        assert np.linalg.norm(state.base_quaternion_world) == pytest.approx(1, abs=1e-6)
