"""Servos on a bus, packet by packet, from this side and from that of the vendors' SDKs."""

import numpy as np
import pytest

from hexctl.backends.bus.families import lx16a as lx
from hexctl.backends.bus.families.lx16a import LOSSY_S, LOST_MOVES, MOST_MOVES, Lx16aBus
from hexctl.backends.bus.families.register_servo import RegisterServo
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PROTOCOLS
from hexctl.backends.bus.servo_bus import BusCounters, ServoBus
from hexctl.backends.bus.tools import bus_of
from hexctl.simulators.bus_board import BusBoard
from hexctl.simulators.lx16a_servos import SimulatedLx16aServo
from hexctl.simulators.register_servos import BusServo
from hexctl.types import FloatArray
from tests.backends.bus.boards import (
    MODELS,
    MODELS_BY_NAME,
    BoardLine,
    LateServoLine,
    MemoryLine,
    a_map,
    register_servo_of,
    sdk_port,
    stance_counts,
)

EVERY = np.ones(18, dtype=bool)


def _positions(bus: ServoBus) -> list[float]:
    return [report.position for report in bus.poll_all()]


def _errors(bus: ServoBus) -> list[str]:
    return [report.error for report in bus.poll_all()]


@pytest.mark.parametrize(("driver", "model"), [*MODELS, ("lx16a", "lx16a")])
def test_servos_are_found_read_and_moved(driver: str, model: str) -> None:
    bus_map = a_map(driver, model)
    line, here, counters = BoardLine(bus_map), stance_counts(bus_map), BusCounters()
    bus = bus_of(bus_map, line, counters)
    assert bus.find().all()
    assert bus.servos[3].model_number() == bus_map.models[3].number
    assert [bus.torque(joint) for joint in (0, 17)] == [False, False]
    assert [servo.set_up() for servo in bus.servos] == [[]] * 18
    report = bus.poll_all()[5]
    assert report.voltage_v == pytest.approx(7.4 if driver == "lx16a" else 12.0)
    assert report.temperature_c == 35
    assert np.isnan(bus.poll_all()[5].voltage_v) == (driver == "lx16a"), "it is read now and then"
    assert _positions(bus) == here.tolist()
    goals = here + np.arange(18) - 9
    bus.write_goals(goals)  # without torque
    line.pass_time(0.1)
    assert _positions(bus) == here.tolist()
    bus.hold(here, EVERY)
    assert line.board._family.holds().all()
    bus.write_goals(goals)
    for _ in range(25):
        bus.poll()
        line.pass_time(0.02)
    assert _positions(bus) == goals.tolist()
    bus.set_torque(False)
    assert not line.board._family.holds().any()
    assert counters.writes == 2


@pytest.mark.parametrize(("driver", "model"), [("dynamixel", "xl430-w250"), ("feetech", "sts3215")])
def test_a_joint_far_beyond_the_limits_stored_in_its_servo_gets_no_goal_and_no_torque(
    driver: str, model: str
) -> None:
    """It was driven to the limit at full speed: Feetech's immediately, Dynamixel's with the next goal."""
    bus_map = a_map(driver, model)
    here = stance_counts(bus_map)
    far, near = np.ceil(20 * bus_map.per_deg[4]), np.floor(1.5 * bus_map.per_deg[5])
    line, table = BoardLine(bus_map), MODELS_BY_NAME[model].table
    bus = bus_of(bus_map, line, BusCounters())
    fourth, fifth = register_servo_of(line.board, 4), register_servo_of(line.board, 5)
    fourth.set(table.most, here[4] - far)
    fifth.set(table.most, here[5] - near)
    before = fourth.number(table.goal)
    bus.find()
    bus.settings(EVERY)
    holds = bus.hold(here, EVERY)
    assert np.flatnonzero(~holds).tolist() == [4]
    assert not fourth.holds
    assert fourth.number(table.goal) == before
    assert fifth.holds
    assert _errors(bus)[4].startswith("stands beyond the limits ")
    bus.set_torque(False)
    assert _errors(bus)[4] == ""


# Servos with registers.


def _register_servo(driver: str, model: str, *faults: str) -> tuple[RegisterServo, BusServo]:
    """Servo with id 5, from the controller's side and as it is."""
    bus_map, line = a_map(driver, model), BoardLine(a_map(driver, model), *faults)
    packets = PacketLine(line, PROTOCOLS[MODELS_BY_NAME[model].table.protocol])
    return RegisterServo(packets, 5, bus_map.models[4]), register_servo_of(line.board, 4)


def test_a_write_that_a_servo_refuses_is_told() -> None:
    servo, real = _register_servo("dynamixel", "xl430-w250")
    table = servo.table
    assert table.mode is not None
    assert servo.write(table.mode.register, 9) == "range"
    assert servo.write(table.least, 1500) == ""
    assert servo.write(table.goal, 1000) == "limit"
    assert servo.write(table.torque, 1) == ""
    assert servo.write(table.mode.register, 4) == "access"
    assert servo.write(table.model, 4) == "access"
    assert real.number(table.mode.register) == 3
    servo, _ = _register_servo("dynamixel", "ax12a")
    assert servo.write(servo.table.most, 500) == ""
    assert servo.write(servo.table.goal, 600) == "angle limit"
    assert servo.value(servo.table.goal) != 600


def test_a_write_that_is_dropped_without_a_word_is_noticed() -> None:
    servo, _ = _register_servo("dynamixel", "ax12a")
    servo.write(servo.table.torque, 1)
    assert servo.write(servo.table.return_delay, 0) == ""
    assert servo.change(servo.table.return_delay, 0) == "it keeps 250"
    assert servo.change(servo.table.return_delay, 250) == ""
    servo.write(servo.table.torque, 0)
    assert servo.change(servo.table.return_delay, 0) == ""


def test_a_damaged_line_is_asked_again() -> None:
    servo, real = _register_servo("feetech", "sts3215", "garble:0.3")
    for value in range(2000, 2040):
        assert servo.change(servo.table.goal, value) in ("", "no answer")
        assert servo.value(servo.table.goal) in (value, None)
    assert 2000 <= real.number(servo.table.goal) < 2040


# Moves of LX-16A servos.

MAP = a_map("lx16a", "lx16a")


def _lx16a_on(line: MemoryLine) -> Lx16aBus:
    bus = bus_of(MAP, line, BusCounters())
    assert isinstance(bus, Lx16aBus)
    return bus


def _lx16a() -> tuple[Lx16aBus, BusBoard]:
    line = BoardLine(MAP)
    return _lx16a_on(line), line.board


def _holding_lx16a() -> tuple[Lx16aBus, BusBoard]:
    """A bus whose servos all hold the stance, and on which no goal waits any more."""
    bus, board = _lx16a()
    bus.find()
    bus.hold(stance_counts(MAP), EVERY)
    for _ in range(3):
        bus.write_goals(stance_counts(MAP))
    return bus, board


def _servo(board: BusBoard, joint: int) -> SimulatedLx16aServo:
    servo = board._servos[joint]
    assert isinstance(servo, SimulatedLx16aServo)
    return servo


def _reach(bus: Lx16aBus, goals: FloatArray) -> bool:
    """Whether the joints come to goals in counts; periods go by meanwhile."""
    return any(bus.poll() and _positions(bus) == goals.tolist() for _ in range(500))


def test_goals_that_did_not_change_are_not_sent_and_others_go_in_halves() -> None:
    bus, board = _holding_lx16a()
    bus.poll_all()
    before = board.counts["goals"]
    bus.write_goals(stance_counts(MAP))
    bus.poll_all()
    assert board.counts["goals"] <= before + 1  # one that was sent long ago
    before = board.counts["goals"]
    bus.write_goals(stance_counts(MAP) + 5)
    bus.poll_all()
    assert board.counts["goals"] == before + MOST_MOVES
    assert _reach(bus, stance_counts(MAP) + 5)


def test_a_joint_whose_goal_had_to_wait_has_two_periods_for_it() -> None:
    bus, board = _holding_lx16a()
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
    bus, board = _holding_lx16a()
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
    bus, board = _holding_lx16a()
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
    bus._line.pass_time(0.06)  # type: ignore[attr-defined]  # until that move has ended
    assert time_of_next_move_s() == 0.02, "a dead servo is no line that loses packets"


def test_a_joint_of_an_lx16a_far_beyond_its_stored_limits_gets_no_goal_and_no_torque() -> None:
    """It was driven to the limit in 20 ms as the torque was switched on; one a little beyond moves there."""
    bus, board = _lx16a()
    here = stance_counts(MAP)
    far, near = int(here[4]) - 50, int(here[5]) - 5
    fourth, fifth = _servo(board, 4), _servo(board, 5)
    fourth.limits, fifth.limits = (0, far), (0, near)
    bus.settings(bus.find())
    holds = bus.hold(here, EVERY)
    assert np.flatnonzero(~holds).tolist() == [4]
    bus.write_goals(np.minimum(here, np.where(np.arange(18) == 4, far, np.inf)))
    errors = _errors(bus)
    assert errors[4] == f"stands beyond the limits 0 to {far} stored in the servo"
    assert "stands" not in errors[5]
    assert not fourth.loaded
    assert fourth._time_s == 0, "no move came"
    assert fifth._goal == near
    bus.set_torque(False)
    assert _errors(bus)[4] == ""


def test_stored_limits_that_no_servo_has_are_not_believed() -> None:
    """As what a servo answers whose memory is damaged: they would end every goal at one count."""
    bus, board = _lx16a()
    for limits in ((700, 300), (400, 400), (0, 5000)):
        _servo(board, 4).limits = limits
        bus.settings(EVERY)
        assert (bus.lowest[4], bus.highest[4]) == (0, 1000)


def test_a_servo_that_unloads_is_limp_and_gets_no_goals() -> None:
    bus, board = _holding_lx16a()
    _servo(board, 7).loaded = False
    assert any(bus.poll() and _errors(bus)[7] for _ in range(500))
    assert _errors(bus) == [""] * 7 + ["limp"] + [""] * 10
    goals = stance_counts(MAP) + 20
    goals[7] -= 20
    bus.write_goals(stance_counts(MAP) + 20)
    assert _reach(bus, goals)
    assert _servo(board, 7)._goal == stance_counts(MAP)[7]


def test_servos_that_begin_to_answer_late_are_heard_again() -> None:
    """The bus had learned to wait for a few ms only, and dropped what came later for good."""
    servo = LateServoLine(
        lx.PACKETS, lambda command, _: (command, bytes(lx.ANSWER_BYTES[command])), baud=115_200
    )
    bus = _lx16a_on(servo)
    for _ in range(80):
        assert bus.servo(7, MAP.models[0]).answers()
    servo.delays_s = [0.02] * 16
    heard = []
    for _ in range(16):
        heard += [bus._ask(6, lx.READ_POSITION)]
        servo.pass_time(0.05)  # what comes late comes between two questions
    assert b"\0\0" in heard[:8]


# The vendors' SDKs on the simulated servos.


def test_the_feetech_sdk_reads_moves_and_renames_the_simulated_servos() -> None:
    import scservo_sdk

    line = BoardLine(a_map(), "overload:2:tibia")
    port = sdk_port(scservo_sdk.PortHandler, line)
    sdk, here = scservo_sdk.sms_sts(port), stance_counts(a_map())
    assert sdk.ping(5) == (777, 0, 0)
    assert sdk.ping(6) == (777, 0, 1 << 5)
    assert sdk.ReadPosSpeed(5)[::2] == (here[4], 0)
    sdk.write1ByteTxRx(5, 40, 1)
    sdk.SyncWritePosEx(5, 2200, 0, 0)
    group = scservo_sdk.GroupSyncWrite(sdk, 42, 2)
    assert group.addParam(5, [2200 & 255, 2200 >> 8])
    assert group.txPacket() == 0
    line.pass_time(1.0)
    assert sdk.ReadPos(5)[0] == 2200
    real = register_servo_of(line.board, 4)
    sdk.write1ByteTxRx(5, 5, 50)  # behind the lock: not kept
    assert sdk.ping(50)[1] == 0
    real.restart()
    assert sdk.ping(5)[1] == 0
    sdk.unLockEprom(5)
    sdk.write1ByteTxRx(5, 5, 50)
    sdk.LockEprom(50)
    real.restart()
    assert sdk.ping(50)[:2] == (777, 0)


@pytest.mark.parametrize(
    ("model", "torque", "setting", "goal", "position", "limit", "beyond"),
    [
        ("xl430-w250", 64, 11, 116, 132, 48, "[RxPacketError] The data value exceeds the limit value!"),
        ("ax12a", 24, 5, 30, 36, 8, "[RxPacketError] Angle limit error!"),
    ],
)
def test_the_dynamixel_sdk_reads_moves_and_is_refused_by_the_simulated_servos(
    model: str, torque: int, setting: int, goal: int, position: int, limit: int, beyond: str
) -> None:
    import dynamixel_sdk

    bus_map = a_map("dynamixel", model)
    line, new = BoardLine(bus_map), model != "ax12a"
    port = sdk_port(dynamixel_sdk.PortHandler, line)
    sdk = dynamixel_sdk.PacketHandler(2.0 if new else 1.0)
    size, read, write = (
        (4, sdk.read4ByteTxRx, sdk.write4ByteTxRx) if new else (2, sdk.read2ByteTxRx, sdk.write2ByteTxRx)
    )
    assert sdk.ping(port, 5) == (bus_map.models[4].number, 0, 0)
    here = int(stance_counts(bus_map)[4])
    assert read(port, 5, position)[0] == here
    assert sdk.write1ByteTxRx(port, 5, torque, 1) == (0, 0)
    group = dynamixel_sdk.GroupSyncWrite(port, sdk, goal, size)
    assert group.addParam(5, (here + 20).to_bytes(size, "little"))
    assert group.txPacket() == 0
    line.pass_time(0.5)
    assert read(port, 5, position)[0] == here + 20
    result, error = sdk.write1ByteTxRx(port, 5, setting, 1)
    refused = "[RxPacketError] Writing or Reading is not available to target address!"
    assert (result, sdk.getRxPacketError(error)) == (0, refused if new else "")
    assert sdk.read1ByteTxRx(port, 5, setting)[0] != 1
    assert sdk.write1ByteTxRx(port, 5, torque, 0) == (0, 0)
    assert write(port, 5, limit, 600) == (0, 0)
    result, error = write(port, 5, goal, 700)
    assert (result, sdk.getRxPacketError(error)) == (0, beyond)


def test_the_dynamixel_sdk_reads_an_alert_and_ends_it_by_a_reboot() -> None:
    import dynamixel_sdk

    line = BoardLine(a_map("dynamixel", "xl430-w250"), "overload:2:femur")
    port, sdk = sdk_port(dynamixel_sdk.PortHandler, line), dynamixel_sdk.PacketHandler(2.0)

    def read(address: int) -> tuple[int, ...]:
        return tuple(sdk.read1ByteTxRx(port, 5, address))

    assert read(70) == (1 << 5, 0, 1 << 7)
    sdk.write1ByteTxRx(port, 5, 64, 1)
    assert read(64)[0] == 0, "only a restart helps"
    sdk.reboot(port, 5)
    line.pass_time(1.0)
    assert read(70) == (0, 0, 0)
    sdk.write1ByteTxRx(port, 5, 64, 1)
    assert read(64) == (1, 0, 0)
