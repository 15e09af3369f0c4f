"""A bus of servos with registers, packet by packet, against simulated ones and the vendors' SDKs."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from hexctl.backends.bus.register_bus import RegisterBus
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.bus.servo_bus import BusCounters
from hexctl.backends.bus.tools import bus_of
from hexctl.errors import RobotFaultError
from hexctl.robot.servos.bus_map import BusMap
from hexctl.simulators.register_servos import BusServo
from tests.backends.bus.boards import MODELS, a_map, bus_board, stance_counts
from tests.backends.bus.memory_line import BoardLine

EVERY = np.ones(18, dtype=bool)


def _bus_on(line: BoardLine, bus_map: BusMap) -> RegisterBus:
    bus = bus_of(bus_map, line, BusCounters())
    assert isinstance(bus, RegisterBus)
    return bus


def _bus(bus_map: BusMap, *faults: str) -> RegisterBus:
    return _bus_on(BoardLine(bus_map, *faults), bus_map)


def _within(condition: Callable[[], bool], seconds: float = 5.0) -> bool:
    deadline_s = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline_s:
            return False
    return True


@pytest.mark.parametrize(("driver", "model"), MODELS)
def test_servos_are_found_read_and_moved(driver: str, model: str) -> None:
    bus_map = a_map(driver, model)
    bus = _bus(bus_map)
    assert bus.find().all()
    assert bus.servos[3].model_number() == bus_map.models[3].number
    assert [bus.torque(joint) for joint in (0, 17)] == [False, False]
    assert [servo.set_up() for servo in bus.servos] == [[]] * 18
    reports = {report.place: report for report in bus.poll_all()}
    assert len(reports) == 18
    positions = np.array([reports[joint].position for joint in range(18)])
    np.testing.assert_array_equal(positions, stance_counts(bus_map))
    assert reports[5].voltage_v == pytest.approx(12.0)
    assert reports[5].temperature_c == 35
    goals = stance_counts(bus_map) + np.arange(18) - 9
    bus.write_goals(goals)  # without torque
    assert isinstance(bus._packets.line, BoardLine)
    bus._packets.line.pass_time(0.1)
    assert {report.position for report in bus.poll_all()} == set(positions)
    bus.hold(positions, EVERY)
    bus.write_goals(goals)
    assert _within(lambda: sorted((r.place, r.position) for r in bus.poll_all()) == list(enumerate(goals)))


@pytest.mark.parametrize(("driver", "model"), [("dynamixel", "xl430-w250"), ("feetech", "sts3215")])
def test_a_joint_far_beyond_the_limits_stored_in_its_servo_gets_no_goal_and_no_torque(
    driver: str, model: str
) -> None:
    """It was driven to the limit at full speed: Feetech's at once, Dynamixel's with the next goal."""
    bus_map = a_map(driver, model)
    here = stance_counts(bus_map)
    far, near = np.ceil(20 * bus_map.per_deg[4]), np.floor(1.5 * bus_map.per_deg[5])
    line = BoardLine(bus_map)
    servos = line.board._servos
    assert isinstance(servos[4], BusServo)
    assert isinstance(servos[5], BusServo)
    bus = _bus_on(line, bus_map)
    servos[4].set(bus.table.most, here[4] - far)
    servos[5].set(bus.table.most, here[5] - near)
    before = servos[4].number(bus.table.goal)
    bus.find()
    bus.settings(EVERY)
    holds = bus.hold(here, EVERY)
    assert np.flatnonzero(~holds).tolist() == [4]
    assert not servos[4].holds
    assert servos[4].number(bus.table.goal) == before
    assert servos[5].holds
    error = {report.place: report.error for report in bus.poll_all()}[4]
    assert error.startswith("stands beyond the limits ")
    bus.set_torque(False)
    assert {report.place: report.error for report in bus.poll_all()}[4] == ""


def test_an_adapter_that_echoes_is_noticed() -> None:
    for model in ("sts3215", "scs0009"):
        bus = _bus(a_map("feetech", model), "echo")
        assert bus.find().all()
        assert len(bus.poll_all()) == 18
        assert bus.servos[0].model_number() == a_map("feetech", model).models[0].number


@pytest.mark.parametrize(("driver", "model"), [("feetech", "sts3215"), ("dynamixel", "ax12a")])
def test_one_mute_servo_does_not_silence_the_others(driver: str, model: str) -> None:
    bus = _bus(a_map(driver, model), "mute:3:femur")
    found = bus.find()
    assert np.flatnonzero(~found).tolist() == [7]
    heard = {report.place for report in bus.poll_all()}
    assert heard == set(range(18)) - {7}


def test_garbled_answers_are_counted_and_never_believed() -> None:
    bus_map = a_map()
    bus = _bus(bus_map, "garble:0.2")
    bus.find()
    for _ in range(60):
        for report in bus.poll():
            assert report.position == stance_counts(bus_map)[report.place]
    assert bus._counters.missed > 20
    assert bus._counters.garbled > 20


def test_a_device_that_is_not_there_is_a_fault_in_one_line() -> None:
    with pytest.raises(RobotFaultError, match=r"^there is no port /dev/nothing; is the cable in"):
        SerialLine("/dev/nothing", 1_000_000)


@pytest.mark.realtime
def test_the_feetech_sdk_reads_and_moves_the_simulated_servos() -> None:
    import scservo_sdk

    bus_map = a_map()
    with bus_board(bus_map) as board:
        port = scservo_sdk.PortHandler(board.path)
        assert port.openPort()
        assert port.setBaudRate(1_000_000)
        sdk = scservo_sdk.sms_sts(port)
        # Asked again: the SDK waits 34 ms, which a busy machine exceeds now and then.
        assert _within(lambda: sdk.ping(5) == (777, 0, 0))
        assert _within(lambda: sdk.ReadPosSpeed(5)[::2] == (stance_counts(bus_map)[4], 0))
        sdk.write1ByteTxRx(5, 40, 1)
        sdk.SyncWritePosEx(5, 2200, 0, 0)
        group = scservo_sdk.GroupSyncWrite(sdk, 42, 2)
        assert group.addParam(5, [2200 & 255, 2200 >> 8])
        assert group.txPacket() == 0
        assert _within(lambda: sdk.ReadPos(5)[0] == 2200)
        port.closePort()


@pytest.mark.realtime
@pytest.mark.parametrize(("model", "protocol"), [("ax12a", 1.0), ("xl430-w250", 2.0)])
def test_the_dynamixel_sdk_reads_and_moves_the_simulated_servos(model: str, protocol: float) -> None:
    import dynamixel_sdk

    bus_map = a_map("dynamixel", model)
    torque, goal, position, size = (24, 30, 36, 2) if protocol == 1 else (64, 116, 132, 4)
    with bus_board(bus_map) as board:
        port, sdk = dynamixel_sdk.PortHandler(board.path), dynamixel_sdk.PacketHandler(protocol)
        assert port.openPort()
        assert _within(lambda: sdk.ping(port, 5) == (bus_map.models[4].number, 0, 0))
        read = sdk.read2ByteTxRx if size == 2 else sdk.read4ByteTxRx
        assert _within(lambda: read(port, 5, position)[0] == stance_counts(bus_map)[4])
        assert _within(lambda: sdk.write1ByteTxRx(port, 5, torque, 1) == (0, 0))
        group = dynamixel_sdk.GroupSyncWrite(port, sdk, goal, size)
        wanted = int(stance_counts(bus_map)[4]) + 20
        assert group.addParam(5, wanted.to_bytes(size, "little"))
        assert group.txPacket() == 0
        assert _within(lambda: read(port, 5, position)[0] == wanted)
        port.closePort()
