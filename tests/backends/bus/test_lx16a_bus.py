"""A bus of LX-16A servos, packet by packet, against simulated ones."""

from collections.abc import Callable

import numpy as np
import pytest

from hexctl.backends.bus import lx16a as lx
from hexctl.backends.bus.lx16a import LOSSY_S, LOST_MOVES, MOST_MOVES, Lx16aBus
from hexctl.backends.bus.servo_bus import BusCounters
from hexctl.backends.bus.tools import bus_of
from hexctl.simulators.bus_board import BusBoard
from hexctl.simulators.lx16a_servos import SimulatedLx16aServo
from hexctl.types import FloatArray
from tests.backends.bus.boards import BoardLine, LateServoLine, MemoryLine, a_map, stance_counts

MAP = a_map("lx16a", "lx16a")
EVERY = np.ones(18, dtype=bool)


def _bus_on(line: MemoryLine, counters: BusCounters) -> Lx16aBus:
    bus = bus_of(MAP, line, counters)
    assert isinstance(bus, Lx16aBus)
    return bus


def _bus(*faults: str) -> tuple[Lx16aBus, BusBoard, BusCounters]:
    line, counters = BoardLine(MAP, *faults), BusCounters()
    return _bus_on(line, counters), line.board, counters


def _pass_time(bus: Lx16aBus, duration_s: float) -> None:
    line = bus._line
    assert isinstance(line, MemoryLine)
    line.pass_time(duration_s)


def _within(condition: Callable[[], bool], polls: int = 500) -> bool:
    return any(condition() for _ in range(polls))


def _hold_stance(bus: Lx16aBus) -> None:
    """Let all servos hold the stance, and no goal wait any more."""
    bus.find()
    bus.hold(stance_counts(MAP), EVERY)
    for _ in range(3):
        bus.write_goals(stance_counts(MAP))


def _servo(board: BusBoard, joint: int) -> SimulatedLx16aServo:
    servo = board._servos[joint]
    assert isinstance(servo, SimulatedLx16aServo)
    return servo


def _reaches(bus: Lx16aBus, goals: FloatArray) -> bool:
    """Whether the joints come to goals in counts; periods go by meanwhile."""

    def there() -> bool:
        bus.poll()
        return bool(_positions(bus) == goals.tolist())

    return _within(there)


def _positions(bus: Lx16aBus) -> list[float]:
    return [report.position for report in bus.poll_all()]


def test_servos_are_found_read_and_moved() -> None:
    bus, board, counters = _bus()
    assert bus.find().all()
    assert bus.servos[3].model_number() is None
    assert [bus.torque(joint) for joint in (0, 17)] == [False, False]
    assert bus.servos[3].set_up() == []
    reports = bus.poll_all()
    assert [report.index for report in reports] == list(range(18))
    assert [report.position for report in reports] == stance_counts(MAP).tolist()
    assert reports[5].voltage_v == pytest.approx(7.4)
    assert reports[5].temperature_c == 35
    assert np.isnan(bus.poll_all()[5].voltage_v), "it is read now and then"
    goals = stance_counts(MAP) + np.arange(18) - 9
    bus.write_goals(goals)  # without torque
    _pass_time(bus, 0.1)
    assert _positions(bus) == stance_counts(MAP).tolist()
    bus.hold(stance_counts(MAP), EVERY)
    assert board._family.holds().all()
    bus.write_goals(goals)
    assert _reaches(bus, goals)
    bus.set_torque(False)
    assert not board._family.holds().any()
    assert counters.writes == 2


def test_goals_that_did_not_change_are_not_sent_and_others_go_in_halves() -> None:
    bus, board, _ = _bus()
    _hold_stance(bus)
    bus.poll_all()
    before = board.counts["goals"]
    bus.write_goals(stance_counts(MAP))
    bus.poll_all()
    assert board.counts["goals"] <= before + 1  # one that was sent long ago
    before = board.counts["goals"]
    bus.write_goals(stance_counts(MAP) + 5)
    bus.poll_all()
    assert board.counts["goals"] == before + MOST_MOVES
    assert _reaches(bus, stance_counts(MAP) + 5)


def test_a_joint_whose_goal_had_to_wait_has_two_periods_for_it() -> None:
    bus, board, _ = _bus()
    _hold_stance(bus)
    goals = stance_counts(MAP) + 5
    bus.write_goals(goals)  # half of them
    bus.write_goals(goals)  # the others, which waited
    bus.poll_all()
    assert [_servo(board, joint)._time_s for joint in range(18)] == [0.04] * 18
    goals[4] += 5
    bus.write_goals(goals)
    bus.poll_all()
    assert _servo(board, 4)._time_s == 0.02


def test_a_move_begins_where_the_one_before_has_come_to() -> None:
    """One of two periods was followed by one of a period, for the half that was left and its own way."""
    bus, board, _ = _bus()
    _hold_stance(bus)
    bus.speeds = np.full(18, 10 / 0.02)  # counts per second: ten in a control period
    bus.write_goals(stance_counts(MAP) + 20)  # half of the joints, in two periods
    moved = next(joint for joint in range(18) if bus._sent[joint] == stance_counts(MAP)[joint] + 20)
    bus._sent_at_s[moved] = bus._time.now() + 10  # as if no time had passed
    goals = bus._sent.copy()
    goals[moved] += 10  # and this joint alone goes on
    bus.write_goals(goals)
    bus.poll_all()
    assert _servo(board, moved)._time_s == 0.06


def test_a_move_behind_lost_answers_has_the_time_of_a_joint_that_missed_the_moves_before() -> None:
    bus, board, _ = _bus()
    _hold_stance(bus)
    bus.speeds = np.full(18, 5 / 0.02)  # counts per second: five in a control period
    goals = stance_counts(MAP)

    def time_of_next_move_s() -> float:
        goals[4] += 5
        bus.write_goals(goals.copy())
        bus.poll_all()
        return _servo(board, 4)._time_s

    assert [time_of_next_move_s() for _ in range(3)] == [0.02] * 3
    board._faults.mute[9] = True
    bus.poll_all()
    assert time_of_next_move_s() == 0.02 * (1 + LOST_MOVES)
    bus._missed_at_s -= 2 * LOSSY_S
    _pass_time(bus, 0.06)  # until that move has ended
    assert time_of_next_move_s() == 0.02, "a dead servo is no line that loses packets"


def _bus_with_a_joint_at(counts: int) -> tuple[Lx16aBus, BusBoard, FloatArray]:
    """A bus whose fourth joint was moved by hand beyond the limits 311 to 331, and where its joints are."""
    bus, board, _ = _bus()
    here = stance_counts(MAP)
    here[4] = counts
    board._robot._positions_rad = MAP.angles_rad(here)  # type: ignore[attr-defined]
    _servo(board, 4).limits = (311, 331)
    bus.settings(bus.find())
    assert _within(lambda: _positions(bus) == here.tolist())
    return bus, board, here


def test_a_joint_far_beyond_the_limits_stored_in_its_servo_gets_no_goal_and_no_torque() -> None:
    """It was driven to the limit, 12 degrees away, in 20 ms as the torque was switched on."""
    bus, board, here = _bus_with_a_joint_at(381)
    holds = bus.hold(here, EVERY)
    assert np.flatnonzero(~holds).tolist() == [4]
    bus.write_goals(stance_counts(MAP))
    assert bus.poll_all()[4].error == "stands beyond the limits 311 to 331 stored in the servo"
    assert not _servo(board, 4).loaded
    assert _servo(board, 4)._time_s == 0, "no move came"
    assert _positions(bus)[4] == 381
    bus.set_torque(False)
    assert bus.poll_all()[4].error == ""


def test_a_joint_a_little_beyond_a_stored_limit_moves_to_it() -> None:
    bus, board, here = _bus_with_a_joint_at(336)
    bus.hold(here, EVERY)
    bus.poll_all()
    assert _servo(board, 4)._goal == 331
    assert "stands" not in bus.poll_all()[4].error


def test_stored_limits_that_no_servo_has_are_not_believed() -> None:
    """As what a servo answers whose memory is damaged: they would end every goal at one count."""
    bus, board, _ = _bus()
    for limits in ((700, 300), (400, 400), (0, 5000)):
        _servo(board, 4).limits = limits
        bus.settings(EVERY)
        assert (bus.lowest[4], bus.highest[4]) == (0, 1000)


def test_a_servo_that_unloads_is_limp_and_gets_no_goals() -> None:
    bus, board, _ = _bus()
    bus.find()
    bus.hold(stance_counts(MAP), EVERY)
    bus.write_goals(stance_counts(MAP))
    _servo(board, 7).loaded = False
    said: dict[int, str] = {}

    def limp() -> bool:
        said.update((report.index, report.error) for report in bus.poll())
        return said.get(7) == "limp"

    assert _within(limp)
    assert {joint for joint, error in said.items() if error} == {7}
    goals = stance_counts(MAP) + 20
    goals[7] -= 20
    bus.write_goals(stance_counts(MAP) + 20)
    assert _reaches(bus, goals)
    assert _servo(board, 7)._goal == stance_counts(MAP)[7]


def test_servos_that_begin_to_answer_late_are_heard_again() -> None:
    """The bus had learned to wait for a few ms only, and dropped what came later for good."""
    servo = LateServoLine(
        lx.LX16A, lambda command, _: (command, bytes(lx.ANSWER_BYTES[command])), baud=115_200
    )
    bus = _bus_on(servo, BusCounters())
    for _ in range(80):
        assert bus.servo(7, MAP.models[0]).answers()
    servo.delays_s = [0.02] * 16
    heard = []
    for _ in range(16):
        heard += [bus._ask(6, lx.READ_POSITION)]
        servo.pass_time(0.05)  # what comes late comes between two questions
    assert b"\0\0" in heard[:8]
