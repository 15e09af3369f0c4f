"""The plug-in of Hiwonder's STM32 board: its packets, and its servos on the simulated board in memory."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hexctl_hiwonder import simulated
from hexctl_hiwonder.inertial import Inertial
from hexctl_hiwonder.packets import BoardPackets, moves, packet

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.families import lx16a as lx
from hexctl.backends.bus.packets import PacketFormat, PacketStream, StatusPacket
from hexctl.backends.bus.serial_line import open_device
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.bus.tools import scan_bus, set_servo_id
from hexctl.control.guard import Guard
from hexctl.errors import RobotFaultError
from hexctl.robot.configs import config_root
from hexctl.robot.loader import load_robot_file
from hexctl.robot.rotations import cos_tilt, product, quaternion_about, yaw_rad
from hexctl.robot.servos.drivers import FAMILIES
from hexctl.types import FloatArray, JointTargets, RobotState
from tests.backends.bus.boards import MemoryBus, a_map, memory_bus, servos_on

PACKETS = BoardPackets()
TICKS_PER_SECOND = 50
ROBOT_FILE = Path(__file__).parents[1] / "examples" / "hiwonder" / "jethexa-stm32.yaml"


@pytest.fixture(autouse=True)
def bus_map(monkeypatch: pytest.MonkeyPatch) -> BusMap:
    """Servos of the family, which is found although it is not installed."""
    monkeypatch.setitem(FAMILIES, "hiwonder", "hexctl_hiwonder.family:HIWONDER")
    return a_map("hiwonder", "hts35h")


@contextmanager
def connected(bus_map: BusMap, *faults: str) -> Iterator[tuple[BusServos, MemoryBus]]:
    with memory_bus(bus_map, *faults) as bus:
        servos = servos_on(bus, bus_map)
        with servos:
            yield servos, bus


def stand(servos: BusServos | Guard, seconds: float) -> RobotState:
    """Hold the stance for a while; the last state."""
    for _ in range(round(seconds * TICKS_PER_SECOND)):
        servos.clock.tick()
        state = servos.read()
        servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
    return state


# Packets


@pytest.mark.parametrize(
    ("sent", "documented"),
    [
        (moves([(1, 833), (2, 1000)], 1000), "05 0A 01 E8 03 02 01 41 03 02 E8 03"),
        (PACKETS.instruction(1, lx.READ_POSITION), "05 02 05 01"),
        (PACKETS.instruction(7, lx.READ_VOLTAGE), "05 02 07 07"),
        (PACKETS.instruction(7, lx.READ_TEMPERATURE), "05 02 09 07"),
        (PACKETS.instruction(7, lx.WRITE_LOAD, b"\0"), "05 02 0B 07"),
        (PACKETS.instruction(7, lx.WRITE_LOAD, b"\1"), "05 02 0C 07"),
        (PACKETS.instruction(7, lx.READ_LOAD), "05 02 0D 07"),
        (PACKETS.instruction(1, lx.WRITE_ID, b"\5"), "05 03 10 01 05"),
        (PACKETS.instruction(254, lx.READ_ID), "05 02 12 FE"),
        (PACKETS.instruction(1, lx.READ_OFFSET), "05 02 22 01"),
        (PACKETS.instruction(1, lx.READ_LIMITS), "05 02 32 01"),
        (PACKETS.instruction(1, lx.READ_VOLTAGE_LIMITS), "05 02 36 01"),
        (PACKETS.instruction(1, lx.READ_MOST_TEMPERATURE), "05 02 3A 01"),
    ],
)
def test_packets_are_those_of_the_protocol_document(sent: bytes, documented: str) -> None:
    body = bytes.fromhex(documented)
    assert sent == b"\xaa\x55" + body + bytes([simulated.crc8(body)])
    assert packet(body[0], body[2:]) == sent


def test_the_checksum_is_crc_8_maxim() -> None:
    assert packet(0, b"")[-1] == 0
    assert simulated.crc8(b"123456789") == 0xA1, "check value of CRC-8/MAXIM-DOW"


def heard(data: bytes) -> tuple[list[StatusPacket], int]:
    stream = PacketStream(PACKETS)
    return stream.feed(data) + stream.finish(), stream.garbled


POSITION = bytes.fromhex("AA 55 05 05 07 05 00 F4 01") + bytes(
    [simulated.crc8(bytes.fromhex("05 05 07 05 00 F4 01"))]
)


def test_answers_name_servo_question_and_value() -> None:
    (answer,), garbled = heard(POSITION)
    assert (answer.servo_id, answer.error, answer.parameters) == (7, lx.READ_POSITION, b"\xf4\x01")
    assert garbled == 0
    assert PACKETS.answers(PACKETS.instruction(7, lx.READ_POSITION), answer)
    assert not PACKETS.answers(PACKETS.instruction(7, lx.READ_VOLTAGE), answer)
    assert not PACKETS.absent(answer)
    (silent,), _ = heard(simulated.frame(5, b"\x07\x05\xff\0\0"))
    assert PACKETS.absent(silent)


@pytest.mark.parametrize(
    "damage",
    [
        b"\x55\x55\x01\x03\x1c\xdf",  # of an LX-16A
        b"\xff\xff\xfd\x00\x01\x03\x00\x01\x19\x4e",  # of a Dynamixel
        POSITION[:5],
        POSITION[:-1] + b"\0",  # another checksum
        b"\xaa\x55\x05\xff",  # longer than any
        b"\xaa\x55\x2a\x02\0\0\0",  # of no function
        b"\xaa",
        b"\xaa\xaa\x55",
    ],
)
def test_damage_is_dropped_and_counted_and_the_next_answer_found(damage: bytes) -> None:
    answers, garbled = heard(damage + POSITION)
    assert [each.parameters for each in answers] == [b"\xf4\x01"]
    assert garbled == len(damage)
    assert heard(damage) == ([], len(damage))


@pytest.mark.parametrize("seed", range(20))
def test_hostile_bytes_do_no_harm(seed: int) -> None:
    random = np.random.default_rng(seed)
    noise = bytes(random.choice([0xAA, 0x55, 5, 2, 0, 7, 0x85], 400).tolist()) + random.bytes(100)
    answers, _ = heard(noise + POSITION)
    assert b"\xf4\x01" in [each.parameters for each in answers]
    for each in (PACKETS, simulated.Frames()):
        taken, done = each.take(noise)
        assert 0 <= done <= len(noise)
        assert taken is None or each.size(taken) <= done


# The servos


@pytest.mark.slow
def test_a_walk_is_measured_with_battery_and_imu(bus_map: BusMap) -> None:
    with connected(bus_map) as (servos, bus):
        state = stand(servos, 3)
        assert state.measured
        assert state.warnings == ()
        assert state.battery_v == pytest.approx(11.1)
        assert state.servos is not None
        assert np.isfinite(state.servos.voltages_v).all()
        assert np.isfinite(state.servos.temperatures_c).all()
        assert state.base_quaternion_world is not None
        assert cos_tilt(*state.base_quaternion_world[1:3]) > np.cos(np.radians(1))
        assert abs(float(yaw_rad(state.base_quaternion_world))) < np.radians(0.5), "its offset is known"
        np.testing.assert_allclose(
            bus.robot.read().joint_positions_rad, servos.robot.stance_angles_rad, atol=0.01
        )


@pytest.mark.slow
def test_positions_are_read_a_few_a_tick_and_the_moves_of_a_tick_are_few_packets(bus_map: BusMap) -> None:
    with connected(bus_map) as (servos, bus):
        stand(servos, 1)
        before, reports = dict(bus.board.counts), servos.counters.reports
        wanted = servos.robot.stance_angles_rad + 0.0
        for tick in range(100):
            servos.clock.tick()
            state = servos.read()
            wanted[:] = servos.robot.stance_angles_rad + 0.1 * np.sin(0.1 * tick + np.arange(18))
            servos.write(JointTargets(wanted, servos.clock.now_s))
        read = (servos.counters.reports - reports) / 100
        sent = (bus.board.counts["goals"] - before["goals"]) / 100
        assert read > 3
        assert sent <= 3, "all servos with one time are in one packet"
        assert state.servos is not None
        assert state.servos.ages_s.max() < servos._map.family.bus.stale_s


@pytest.mark.slow
def test_without_torque_the_robot_goes_limp(bus_map: BusMap) -> None:
    with connected(bus_map) as (servos, bus):
        stand(servos, 1)
        assert bus.board._family.holds().all()
        servos.disable_torque()
        for _ in range(50):
            servos.clock.tick()
            servos.read()
        assert not bus.board._family.holds().any()


@pytest.mark.slow
def test_a_board_whose_torque_is_exchanged_gets_no_goal(
    bus_map: BusMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the vendor's SDK has it: then the read-back tells the truth."""
    monkeypatch.setitem(simulated.ORDERS, 0x0B, (31, b"\1"))
    monkeypatch.setitem(simulated.ORDERS, 0x0C, (31, b"\0"))
    with connected(bus_map) as (servos, bus):
        state = stand(servos, 1)
        assert any("no torque: all servos" in each for each in state.warnings), state.warnings
        assert not bus.board._family.holds().any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "warning"),
    [
        (("mute:2:femur",), "mute: leg 2 femur"),
        (("same-id:2:femur",), "mute: leg 2 coxa (id 4), leg 2 femur (id 5)"),
        (("overload:3:femur@2",), "limp: leg 3 femur"),
        (("hot:2:tibia:72@2",), "hot, 72 degrees C: leg 2 tibia"),
        (("brown-out@2",), "brown-out"),
        (("garble:0.2",), "bad cable or noise"),
        (("bad-cable:2:femur:0.3",), "bad cable or noise: answers of leg 2 femur"),
    ],
)
def test_faults_are_named(bus_map: BusMap, faults: tuple[str, ...], warning: str) -> None:
    with connected(bus_map, *faults) as (servos, _):
        state = stand(servos, 6)
        assert any(warning in each for each in state.warnings), state.warnings
        if state.base_quaternion_world is not None:
            assert cos_tilt(*state.base_quaternion_world[1:3]) > np.cos(np.radians(2))


@pytest.mark.slow
@pytest.mark.parametrize("faults", [("noise:0.5",), ("echo",), ("wild-once@2",), ("garble:0.02",)])
def test_little_damage_changes_nothing(bus_map: BusMap, faults: tuple[str, ...]) -> None:
    with connected(bus_map, *faults) as (servos, bus):
        state = stand(servos, 4)
        assert state.fault is None
        assert not any("mute" in each or "jump" in each for each in state.warnings), state.warnings
        np.testing.assert_allclose(
            bus.robot.read().joint_positions_rad, servos.robot.stance_angles_rad, atol=0.01
        )


@pytest.mark.slow
def test_a_board_that_disappears_and_returns_is_used_again(bus_map: BusMap) -> None:
    with connected(bus_map, "unplug@4", "replug@9") as (servos, _):
        state = stand(servos, 5)
        assert state.fault is not None
        assert state.base_quaternion_world is None, "what the IMU felt is old"
        assert stand(servos, 6).fault is None


@pytest.mark.slow
def test_a_lost_port_is_opened_again(bus_map: BusMap) -> None:
    with connected(bus_map) as (servos, bus):
        stand(servos, 1)
        bus.unplugged = True
        for _ in range(30):
            servos.clock.tick()
            state = servos.read()
        assert not state.healthy
        bus.unplugged = False
        state = stand(servos, 3)
        assert state.healthy
        assert servos.counters.reopened == 1
        assert state.battery_v is not None


def test_a_board_without_powered_servos_is_told_from_no_board(bus_map: BusMap) -> None:
    with (
        memory_bus(bus_map, "only:1:coxa", "mute:1:coxa") as bus,
        pytest.raises(RobotFaultError, match=r"the board on .* answers, but none of its servos"),
    ):
        servos_on(bus, bus_map).connect()
    with memory_bus(bus_map, "unplug") as bus, pytest.raises(RobotFaultError, match="no servo answers"):
        servos_on(bus, bus_map).connect()


@pytest.mark.parametrize("others", [("lx16a", "hts35h"), ("feetech", "sts3215")])
def test_another_protocol_is_refused(bus_map: BusMap, others: tuple[str, str]) -> None:
    with memory_bus(a_map(*others)) as bus, pytest.raises(RobotFaultError, match=r"no servo|damaged"):
        servos_on(bus, bus_map).connect()
    with memory_bus(bus_map) as bus, pytest.raises(RobotFaultError, match=r"damaged|unsolicited"):
        servos_on(bus, a_map(*others)).connect()


def test_a_wrong_baud_rate_is_refused(bus_map: BusMap) -> None:
    with (
        memory_bus(bus_map, baud=115_200) as bus,
        pytest.raises(RobotFaultError, match="wrong baud rate"),
    ):
        servos_on(bus, bus_map).connect()


def test_a_scan_asks_silent_ids_no_longer_than_the_board_does(bus_map: BusMap) -> None:
    with memory_bus(bus_map) as bus:
        begun_s = bus.time.now()
        found = scan_bus(bus.path, "hiwonder", 1_000_000, ids=range(1, 101))
        assert [each.servo_id for each in found] == list(range(1, 19))
        assert found[0].voltage_v == 11.1
        assert found[0].variant == "4.5 to 12 V"
        assert bus.time.now() - begun_s < 100 * 0.02


def test_the_only_servo_gets_another_id(bus_map: BusMap) -> None:
    with memory_bus(bus_map, "only:1:coxa") as bus:
        assert set_servo_id(bus.path, "hiwonder", 1_000_000, 40).servo_id == 40


@pytest.mark.slow
def test_stored_limits_end_goals(bus_map: BusMap) -> None:
    with memory_bus(bus_map) as bus:
        family = bus.board._family
        assert isinstance(family, simulated.HiwonderBoard)
        for servo in family.servos:
            servo.limits = (450, 550)
        servos = servos_on(bus, bus_map)
        with servos:
            state = stand(servos, 2)
        assert any("stored limits 450 to 550" in each for each in state.warnings)


@pytest.mark.slow
def test_when_the_computer_dies_the_pose_stays(bus_map: BusMap) -> None:
    """The board has no watchdog: servos finish the last move, and hold."""
    with memory_bus(bus_map) as bus:
        servos = servos_on(bus, bus_map)
        servos.connect()
        stand(servos, 1)
        servos.clock.tick()
        servos.write(JointTargets(servos.robot.stance_angles_rad + 0.02, servos.clock.now_s))
        servos.close()
        family = bus.board._family
        bus.time.sleep(0.1)
        goals = family.goals(bus.time.now())
        bus.time.sleep(60)
        assert family.holds().all()
        np.testing.assert_array_equal(family.goals(bus.time.now()), goals)


# The IMU

STILL = np.array([0.0, 0.0, 1.0, 0.4, -0.7, -1.9])


def samples_of(turns: FloatArray, quaternion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Samples each 10 ms while a body turns about its own axes, by rates (n, 3) in rad/s, and its end."""
    samples = []
    for rate in turns:
        if rate.any():
            size = float(np.linalg.norm(rate))
            quaternion = product(quaternion, quaternion_about(rate / size, 0.01 * size))
        w, x, y, z = quaternion
        up = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
        samples.append([*up, *(np.degrees(rate) + STILL[3:])])
    return np.array(samples), quaternion


def feel(samples: FloatArray) -> Inertial:
    inertial = Inertial()
    for at in range(0, len(samples), 2):
        inertial.take(samples[at : at + 2], 0.01 * at)
    return inertial


def test_the_orientation_follows_turns_about_any_axis() -> None:
    rest = np.zeros((200, 3))
    for axis in np.eye(3):
        turns = np.vstack([rest, np.tile(0.8 * axis, (100, 1))])
        samples, true = samples_of(turns, quaternion_about((0.6, 0.8, 0.0), 0.2))
        quaternion = feel(samples).quaternion
        assert quaternion is not None
        first = feel(samples[:200]).quaternion
        assert first is not None
        # Only the yaw at the begin is not known.
        begin = quaternion_about((0.6, 0.8, 0.0), 0.2)
        turned = product(about_vertical(first, begin), true)
        assert abs(float(quaternion @ turned)) > np.cos(np.radians(1.5))


def about_vertical(first: FloatArray, true: FloatArray) -> FloatArray:
    """Turn about the vertical between two orientations of one tilt."""
    return quaternion_about((0, 0, 1), float(yaw_rad(first) - yaw_rad(true)))


def test_nothing_is_said_before_the_offset_is_known_and_by_an_imu_on_its_side() -> None:
    turning, _ = samples_of(np.tile([0.0, 0.0, 0.5], (90, 1)), np.array([1.0, 0, 0, 0]))
    assert feel(turning).quaternion is None
    on_its_side = np.tile(STILL[[0, 2, 1, 3, 4, 5]], (300, 1))
    assert feel(on_its_side).quaternion is None
    shaking = np.tile(STILL, (300, 1))
    shaking[::7, 4] += 30
    assert feel(shaking).quaternion is None


def test_one_wrong_sample_turns_nothing() -> None:
    samples = np.tile(STILL, (400, 1))
    samples[300] = [-16, 16, -16, 2000, -2000, 2000]
    quaternion = feel(samples).quaternion
    assert quaternion is not None
    assert quaternion[0] > np.cos(np.radians(0.1))


@pytest.mark.slow
@pytest.mark.parametrize("numbers", [(np.nan, 0, 1, 0, 0, 0), (0, 0, 17, 0, 0, 0), (0, 0, 1, 0, 0, 2001)])
def test_impossible_samples_are_dropped(bus_map: BusMap, numbers: tuple[float, ...]) -> None:
    with connected(bus_map) as (servos, _):
        stand(servos, 3)
        device: Any = servos._thread and servos._thread._device
        before = device.board().quaternion
        for _ in range(10):
            device._take_report(StatusPacket(0x107, 0, struct.pack("<6f", *numbers)))
        assert not device._samples or np.isfinite(device._samples).all()
        assert device.board().quaternion is before or device.board().quaternion @ before > 0.999


@pytest.mark.slow
def test_a_fall_stops_the_robot(bus_map: BusMap, monkeypatch: pytest.MonkeyPatch) -> None:
    lean = [0.0]

    def felt(_board: object, _state: RobotState) -> tuple[FloatArray, FloatArray]:
        rate = 150.0 if 0 < lean[0] < 90 else 0.0
        lean[0] = min(lean[0] + rate * 0.02, 90.0) if lean[0] else 0.0
        angle = np.radians(lean[0])
        return np.array([0.0, np.sin(angle), np.cos(angle)]), np.array([rate, 0.0, 0.0])

    monkeypatch.setattr(simulated.HiwonderBoard, "_felt", felt)
    with memory_bus(bus_map) as bus, Guard(servos_on(bus, bus_map)) as guard:
        state = stand(guard, 3)
        assert guard.stopped is None
        lean[0] = 1.0
        for _ in range(100):
            guard.clock.tick()
            state = guard.read()
        assert guard.stopped == "fell"
        assert state.base_quaternion_world is not None


# The port and the file


def test_dtr_and_rts_stay_low(monkeypatch: pytest.MonkeyPatch, bus_map: BusMap) -> None:
    opened: list[tuple[bool, bool]] = []

    class Port:
        def __init__(self, port: str | None, *_: object, **__: object) -> None:
            assert port is None, "an opened port sets both lines"
            self.dtr = self.rts = True

        def open(self) -> None:
            opened.append((self.dtr, self.rts))

    monkeypatch.setattr("serial.Serial", Port)
    open_device("x", 1_000_000, modem_lines=bus_map.family.modem_lines)
    open_device("x", 1_000_000)
    assert opened == [(False, False), (True, True)]


def test_the_robot_file_is_that_of_jethexa_with_another_driver() -> None:
    shipped = yaml.safe_load((config_root() / "robots" / "jethexa.yaml").read_text(encoding="utf-8"))
    ours = yaml.safe_load(ROBOT_FILE.read_text(encoding="utf-8"))
    for key in ("name", "description"):
        del shipped[key], ours[key]
    assert ours["servos"] == shipped["servos"] | {"driver": "hiwonder", "port": "/dev/ttyACM0"}
    assert ours.pop("sensors") == ["joint_positions", "imu"]
    assert ours | {"servos": None} == shipped | {"servos": None}
    assert load_robot_file(ROBOT_FILE).robot.name == "jethexa-stm32"


def test_the_simulated_board_has_packets_of_its_own(bus_map: BusMap) -> None:
    with memory_bus(bus_map) as bus:
        frames: PacketFormat = bus.board._family.packets
        assert type(frames) is simulated.Frames
        assert isinstance(bus_map.family.formats[1], BoardPackets)
