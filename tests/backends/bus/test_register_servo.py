"""The memory of one servo: what it takes, and what is said of what it refuses. The SDK says the same."""

from collections.abc import Callable

import pytest

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PROTOCOLS, READ
from hexctl.backends.bus.register_servo import RegisterServo
from hexctl.backends.bus.registers import table_of
from hexctl.simulators.register_servos import BusServo
from tests.backends.bus.boards import a_map, bus_board
from tests.backends.bus.memory_line import BoardLine


def _servo(driver: str, model: str, *faults: str) -> tuple[RegisterServo, BusServo]:
    """Servo with id 5, from the controller's side and as it is."""
    bus_map, table = a_map(driver, model), table_of(model)
    line = BoardLine(bus_map, *faults)
    real = line.board._servos[4]
    assert isinstance(real, BusServo)
    packets = PacketLine(line, PROTOCOLS[table.protocol])
    return RegisterServo(packets, 5, bus_map.models[4]), real


def test_what_a_servo_refuses_is_said() -> None:
    servo, real = _servo("dynamixel", "xl430-w250")
    table = servo.table
    assert table.mode is not None
    assert servo.write(table.mode, 9) == "range"
    assert servo.write(table.least, 1500) == ""
    assert servo.write(table.goal, 1000) == "limit"
    assert servo.write(table.torque, 1) == ""
    assert servo.write(table.mode, 4) == "access"
    assert servo.write(table.model, 4) == "access"
    assert real.number(table.mode) == 3
    servo, _ = _servo("dynamixel", "ax12a")
    assert servo.write(servo.table.most, 500) == ""
    assert servo.write(servo.table.goal, 600) == "angle limit"
    assert servo.value(servo.table.goal) != 600


def test_a_write_that_is_dropped_without_a_word_is_noticed() -> None:
    servo, _ = _servo("dynamixel", "ax12a")
    servo.write(servo.table.torque, 1)
    assert servo.write(servo.table.return_delay, 0) == ""
    assert servo.change(servo.table.return_delay, 0) == "it keeps 250"
    assert servo.change(servo.table.return_delay, 250) == ""
    servo.write(servo.table.torque, 0)
    assert servo.change(servo.table.return_delay, 0) == ""


def test_a_damaged_line_is_asked_again() -> None:
    servo, real = _servo("feetech", "sts3215", "garble:0.3")
    for value in range(2000, 2040):
        assert servo.change(servo.table.goal, value) in ("", "no answer")
        assert servo.value(servo.table.goal) in (value, None)
    assert 2000 <= real.number(servo.table.goal) < 2040


def test_a_late_answer_is_not_taken_for_another() -> None:
    """An answer says nothing of its question: that of the one before would pass for it."""
    servo, _ = _servo("dynamixel", "xl430-w250")
    table, packets = servo.table, servo._packets
    assert table.mode is not None
    for register, number in ((table.flags, 0), (table.shutdown, 36), (table.servo_id, 5)):
        mode = packets.packets.place(table.mode.address, 1)
        packets.tell(5, READ, mode)  # whose answer, 3, nobody waits for
        packets.line.discard = lambda: False  # type: ignore[method-assign]  # it comes after that
        assert servo.sure(register) == number


def test_what_is_stored_behind_a_lock_goes_with_the_power() -> None:
    servo, real = _servo("feetech", "sts3215")
    table = servo.table
    assert servo.change(table.return_delay, 0) == ""
    real.restart()
    assert servo.raw(table.return_delay) == 250
    assert table.unlock is not None
    assert servo.change(table.unlock, 0) == ""
    assert servo.change(table.return_delay, 0) == ""
    real.restart()
    assert servo.raw(table.return_delay) == 0
    assert servo.raw(table.unlock) == 1


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("model", "protocol", "torque", "setting", "goal", "limit", "beyond"),
    [
        ("xl430-w250", 2.0, 64, 11, 116, 48, "[RxPacketError] The data value exceeds the limit value!"),
        ("ax12a", 1.0, 24, 5, 30, 8, "[RxPacketError] Angle limit error!"),
    ],
)
def test_the_sdk_reads_the_same_refusals(
    model: str, protocol: float, torque: int, setting: int, goal: int, limit: int, beyond: str
) -> None:
    import dynamixel_sdk

    with bus_board(a_map("dynamixel", model)) as board:
        port, sdk = dynamixel_sdk.PortHandler(board.path), dynamixel_sdk.PacketHandler(protocol)
        assert port.openPort()
        long = sdk.write4ByteTxRx if protocol == 2 else sdk.write2ByteTxRx
        assert long(port, 5, limit, 600) == (0, 0)
        result, error = long(port, 5, goal, 700)
        assert result == 0
        assert sdk.getRxPacketError(error) == beyond
        assert sdk.write1ByteTxRx(port, 5, torque, 1) == (0, 0)
        result, error = sdk.write1ByteTxRx(port, 5, setting, 1)
        refused = "[RxPacketError] Writing or Reading is not available to target address!"
        assert sdk.getRxPacketError(error) == (refused if protocol == 2 else "")
        assert sdk.read1ByteTxRx(port, 5, setting)[0] != 1
        port.closePort()


def _answer(ask: Callable[[], tuple[int, int, int]]) -> tuple[int, int, int]:
    """Value, result and error of a question to an SDK, which gives up early: asked again."""
    for _ in range(10):
        answer = ask()
        if answer[1] == 0:
            return answer
    raise AssertionError(answer)


@pytest.mark.realtime
def test_the_feetech_sdk_unlocks_renames_and_reads_an_overload() -> None:
    import scservo_sdk

    with bus_board(a_map(), "overload:2:coxa") as board:
        port = scservo_sdk.PortHandler(board.path)
        assert port.openPort()
        assert port.setBaudRate(1_000_000)
        sdk = scservo_sdk.sms_sts(port)
        assert _answer(lambda: sdk.ping(4)) == (777, 0, 1 << 5)
        sdk.write1ByteTxRx(5, 5, 50)  # behind the lock: not kept
        real = board._servos[4]
        assert isinstance(real, BusServo)
        assert _answer(lambda: sdk.ping(50))[1] == 0
        real.restart()
        assert _answer(lambda: sdk.ping(5))[1] == 0
        sdk.unLockEprom(5)
        sdk.write1ByteTxRx(5, 5, 50)
        sdk.LockEprom(50)
        real.restart()
        assert _answer(lambda: sdk.ping(50))[:2] == (777, 0)
        port.closePort()


@pytest.mark.realtime
def test_the_dynamixel_sdk_reads_an_alert_and_ends_it_by_a_reboot() -> None:
    import dynamixel_sdk

    with bus_board(a_map("dynamixel", "xl430-w250"), "overload:2:femur") as board:
        port, sdk = dynamixel_sdk.PortHandler(board.path), dynamixel_sdk.PacketHandler(2.0)
        assert port.openPort()

        def read(address: int) -> tuple[int, int, int]:
            return _answer(lambda: sdk.read1ByteTxRx(port, 5, address))

        assert read(70) == (1 << 5, 0, 1 << 7)
        sdk.write1ByteTxRx(port, 5, 64, 1)
        assert read(64)[0] == 0, "only a restart helps"
        sdk.reboot(port, 5)
        assert read(70) == (0, 0, 0)
        sdk.write1ByteTxRx(port, 5, 64, 1)
        assert read(64) == (1, 0, 0)
        port.closePort()
