"""Servos with registers, packet by packet, from this side and from that of the vendors' SDKs."""

import numpy as np
import pytest

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PROTOCOLS
from hexctl.backends.bus.register_bus import RegisterBus
from hexctl.backends.bus.register_servo import RegisterServo
from hexctl.backends.bus.registers import table_of
from hexctl.backends.bus.servo_bus import BusCounters
from hexctl.backends.bus.tools import bus_of
from hexctl.robot.servos.bus_map import BusMap
from hexctl.simulators.register_servos import BusServo
from tests.backends.bus.boards import MODELS, BoardLine, a_map, register_servo_of, sdk_port, stance_counts

EVERY = np.ones(18, dtype=bool)


def _bus_on(line: BoardLine, bus_map: BusMap) -> RegisterBus:
    bus = bus_of(bus_map, line, BusCounters())
    assert isinstance(bus, RegisterBus)
    return bus


@pytest.mark.parametrize(("driver", "model"), MODELS)
def test_servos_are_found_read_and_moved(driver: str, model: str) -> None:
    bus_map = a_map(driver, model)
    line = BoardLine(bus_map)
    bus = _bus_on(line, bus_map)
    assert bus.find().all()
    assert bus.servos[3].model_number() == bus_map.models[3].number
    assert [bus.torque(joint) for joint in (0, 17)] == [False, False]
    assert [servo.set_up() for servo in bus.servos] == [[]] * 18
    reports = {report.index: report for report in bus.poll_all()}
    assert len(reports) == 18
    positions = np.array([reports[joint].position for joint in range(18)])
    np.testing.assert_array_equal(positions, stance_counts(bus_map))
    assert reports[5].voltage_v == pytest.approx(12.0)
    assert reports[5].temperature_c == 35
    goals = stance_counts(bus_map) + np.arange(18) - 9
    bus.write_goals(goals)  # without torque
    line.pass_time(0.1)
    assert {report.position for report in bus.poll_all()} == set(positions)
    bus.hold(positions, EVERY)
    bus.write_goals(goals)
    line.pass_time(0.5)
    assert sorted((each.index, each.position) for each in bus.poll_all()) == list(enumerate(goals))


@pytest.mark.parametrize(("driver", "model"), [("dynamixel", "xl430-w250"), ("feetech", "sts3215")])
def test_a_joint_far_beyond_the_limits_stored_in_its_servo_gets_no_goal_and_no_torque(
    driver: str, model: str
) -> None:
    """It was driven to the limit at full speed: Feetech's immediately, Dynamixel's with the next goal."""
    bus_map = a_map(driver, model)
    here = stance_counts(bus_map)
    far, near = np.ceil(20 * bus_map.per_deg[4]), np.floor(1.5 * bus_map.per_deg[5])
    line = BoardLine(bus_map)
    bus = _bus_on(line, bus_map)
    fourth, fifth = register_servo_of(line.board, 4), register_servo_of(line.board, 5)
    fourth.set(bus.table.most, here[4] - far)
    fifth.set(bus.table.most, here[5] - near)
    before = fourth.number(bus.table.goal)
    bus.find()
    bus.settings(EVERY)
    holds = bus.hold(here, EVERY)
    assert np.flatnonzero(~holds).tolist() == [4]
    assert not fourth.holds
    assert fourth.number(bus.table.goal) == before
    assert fifth.holds
    error = {report.index: report.error for report in bus.poll_all()}[4]
    assert error.startswith("stands beyond the limits ")
    bus.set_torque(False)
    assert {report.index: report.error for report in bus.poll_all()}[4] == ""


def _servo(driver: str, model: str, *faults: str) -> tuple[RegisterServo, BusServo]:
    """Servo with id 5, from the controller's side and as it is."""
    bus_map, line = a_map(driver, model), BoardLine(a_map(driver, model), *faults)
    packets = PacketLine(line, PROTOCOLS[table_of(model).protocol])
    return RegisterServo(packets, 5, bus_map.models[4]), register_servo_of(line.board, 4)


def test_a_write_that_a_servo_refuses_is_told() -> None:
    servo, real = _servo("dynamixel", "xl430-w250")
    table = servo.table
    assert table.mode is not None
    assert servo.write(table.mode.register, 9) == "range"
    assert servo.write(table.least, 1500) == ""
    assert servo.write(table.goal, 1000) == "limit"
    assert servo.write(table.torque, 1) == ""
    assert servo.write(table.mode.register, 4) == "access"
    assert servo.write(table.model, 4) == "access"
    assert real.number(table.mode.register) == 3
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


def test_a_setting_behind_a_lock_goes_with_the_power() -> None:
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
