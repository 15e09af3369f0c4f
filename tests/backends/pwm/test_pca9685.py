"""Hobby servos on two PCA9685 boards: registers, powering, losses of power, a bus that lies, and sockets."""

import errno
import random
import socket
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from smbus2 import i2c_msg

from hexctl.backends.base import LegServos
from hexctl.backends.pwm.i2c_socket import I2cMessage, I2cSocket, decode_transaction, encode_transaction
from hexctl.backends.pwm.pca9685 import I2cBus, Pca9685, Pca9685Servos, open_i2c, prescale_of
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.backends.sim.servos import SimServos
from hexctl.errors import MissingExtraError, RobotFaultError
from hexctl.simulators.pca9685_board import SimulatedI2c, SimulatedPca9685
from hexctl.types import N_JOINTS, FloatArray, JointTargets, RobotState
from hexctl.waiting import wait_for
from hexctl.wire.zenoh_messages import MAX_TEXT_BYTES
from tests.backends.fake_time import FakeTime
from tests.backends.powering import HobbyServosConformance
from tests.backends.pwm.boards import a_map, i2c_servos_on, pca9685_board
from tests.backends.pwm.i2c import ChipBus, FlatBus, byte_of
from tests.backends.standing import next_state, stand, until
from tests.robots import shipped

#: A count at 50 Hz.
COUNT_US = 122 / 25


def _servos(bus: I2cBus, pwm_map: PwmMap | None = None) -> Pca9685Servos:
    used = a_map("pca9685") if pwm_map is None else pwm_map
    servos = Pca9685Servos(shipped(), pwm_map=used, port="1", clock=FakeTime().clock())

    def board() -> Pca9685:
        return Pca9685(bus, used, servos.clock.time, known=servos._known)

    servos._open = board  # type: ignore[method-assign]
    return servos


def _power(servos: LegServos, bus: ChipBus, offset_rad: float = 0.0) -> None:
    """Command a pose until all servos have pulses."""
    until(servos, lambda _: (bus.pulses_us()[:18] > 0).all(), offset_rad=offset_rad)


def _limp(servos: LegServos, *chips: SimulatedPca9685) -> None:
    """Wait until no servo of some boards has pulses."""
    until(servos, lambda _: not any(chip.pulses_us().any() for chip in chips), write=False)


class TestChips(HobbyServosConformance):
    @pytest.fixture(autouse=True)
    def chips(self) -> None:
        self.bus = ChipBus()

    def make(self) -> Pca9685Servos:
        return _servos(self.bus)

    def pulses_us(self) -> FloatArray:
        return self.bus.pulses_us()[:18]


def _referee_us(registers: bytes, channel: int, clock_hz: float = 25e6) -> float:
    """Pulse of a channel as drivers of these boards understand their registers.

    Adafruit's has the frequency clock / 4096 / (prescale + 1) and writes (ON, OFF) as (0, counts), and
    Freenove's has ON = 0 and OFF = pulse * 4096 * 50 / 1e6; both are off where bit 12 of OFF is set.
    """
    prescale, base = registers[0xFE], 0x06 + 4 * channel
    on, off = (int.from_bytes(registers[base + 2 * n : base + 2 * n + 2], "little") for n in (0, 1))
    assert on == 0
    frequency = clock_hz / 4096 / (prescale + 1)
    assert frequency == pytest.approx(50, rel=0.01)
    return 0.0 if off & 0x1000 else off * 1e6 / 4096 / frequency


def test_registers_are_what_other_drivers_take_them_for() -> None:
    bus, robot = FlatBus(), shipped()
    with _servos(bus) as servos:
        wanted = a_map("pca9685").raw(robot.stance_angles_rad)
        until(servos, lambda _: bus.memories[0x41][0x06 + 4 + 3] != 0x10 and bus.memories[0x41][8])
        for joint in range(18):
            memory = bytes(bus.memories[0x40 if joint < 16 else 0x41])
            assert _referee_us(memory, joint % 16) == pytest.approx(wanted[joint], abs=COUNT_US / 2)
            # Freenove's own line, at its nominal frequency.
            off = int.from_bytes(memory[0x08 + 4 * (joint % 16) : 0x0A + 4 * (joint % 16)], "little")
            assert off == pytest.approx(wanted[joint] * 4096 * 50 / 1e6, abs=1.0)
        for memory in map(bytes, bus.memories.values()):
            assert (memory[0x00], memory[0x01], memory[0xFE]) == (0x20, 0x04, 121)


@pytest.mark.parametrize(("oscillator_mhz", "prescale"), [(25.0, 121), (26.3, 127), (23.9, 116)])
def test_pulses_are_right_with_an_oscillator_that_is_not(oscillator_mhz: float, prescale: int) -> None:
    assert prescale_of(oscillator_mhz) == prescale
    bus = ChipBus({0x40: SimulatedPca9685(oscillator_mhz), 0x41: SimulatedPca9685(25.0)})
    pwm_map = a_map("pca9685", oscillator_mhz=[oscillator_mhz, 25])
    wanted = pwm_map.raw(shipped().stance_angles_rad)
    with _servos(bus, pwm_map) as servos:
        _power(servos, bus)
        np.testing.assert_allclose(bus.pulses_us()[:18], wanted, atol=COUNT_US / 2 + 0.1)


def test_the_prescaler_is_set_in_sleep_and_servos_are_off_by_the_bit_that_is_made_for_it() -> None:
    bus = ChipBus()
    with _servos(bus) as servos:
        for address in (0x40, 0x41):
            assert bus.chips[address].registers[0xFE] == 121, "which chips take in sleep alone"
            assert not bus.chips[address].registers[0x00] & 0x10
        assert not servos.holds
        _power(servos, bus)
        assert servos.holds
        assert not bus.pulses_us()[18:].any()
        servos.disable_torque()
        _limp(servos, *bus.chips.values())
        assert bus.chips[0x40].registers[0x09] == 0x10


@pytest.mark.parametrize("prescale", [121, 130])
def test_the_pose_of_an_earlier_program_is_kept_whatever_its_frequency(prescale: int) -> None:
    bus = ChipBus()
    with _servos(bus) as servos:
        _power(servos, bus, offset_rad=0.1)
    for chip in bus.chips.values():
        chip.write(bytes([0x00, 0x10]))
        chip.write(bytes([0xFE, prescale]))
        chip.write(bytes([0x00, 0x00]))
        assert not chip.pulses_us().any(), "they wait for a restart"
        chip.write(bytes([0x00, 0x80]))
    before = bus.pulses_us()
    with _servos(bus) as servos:
        np.testing.assert_allclose(bus.pulses_us(), before, atol=COUNT_US / 2)
        expected = a_map("pca9685").angles_rad(before[:18])
        np.testing.assert_allclose(servos.read().joint_positions_rad, expected, atol=0.005)
        for _ in range(25):
            stand(servos, 1, 0.1)
            assert (bus.pulses_us()[:18] > 0).all(), "no leg is let go of"


def test_a_board_that_lost_its_power_is_a_fault_until_the_torque_was_off() -> None:
    bus, address = ChipBus(), 0x41
    with _servos(bus) as servos:
        _power(servos, bus)
        with bus.lock:
            bus.chips[address].reset()
        state = until(servos, lambda state: not state.healthy)
        assert "0x41 has lost its settings" in str(state.fault)
        assert servos.holds, "the other board's servos do"
        assert len(f"fault: {state.fault}") <= MAX_TEXT_BYTES, "it is told whole over the link"
        until(servos, lambda _: servos.clock.now_s > 1.5)
        assert not bus.chips[address].pulses_us().any(), "nothing is powered again by itself"
        servos.disable_torque()
        until(servos, lambda state: state.healthy, write=False)
        assert not bus.pulses_us().any()
        _power(servos, bus)


def test_a_bus_that_comes_back_leaves_the_robot_standing() -> None:
    bus = ChipBus()
    with _servos(bus) as servos:
        _power(servos, bus)
        bus.fails = lambda _: True
        until(servos, lambda state: not state.healthy)
        bus.fails = lambda _: False
        until(servos, lambda state: state.healthy)
        for _ in range(25):
            stand(servos, 1)
            assert (bus.pulses_us()[:18] > 0).all()


def test_a_torque_off_that_one_board_does_not_hear_reaches_the_other_and_is_tried_again() -> None:
    bus = ChipBus()
    with _servos(bus) as servos:
        _power(servos, bus)
        bus.fails = lambda address: address == 0x40
        servos.disable_torque()
        _limp(servos, bus.chips[0x41])
        bus.fails = lambda _: False
        _limp(servos, bus.chips[0x40])


def test_transfers_that_fail_now_and_then_and_readings_that_are_wrong_once_stop_nothing() -> None:
    dice, bus = random.Random(1), ChipBus()
    bus.spoils = lambda value: dice.randrange(256) if dice.random() < 0.02 else value
    with _servos(bus) as servos:
        bus.fails = lambda _: dice.random() < 0.2
        for _ in range(150):
            state = stand(servos, 1)
            assert state.healthy, state.fault
        assert (bus.pulses_us()[:18] > 0).all()


def test_a_pose_that_a_board_did_not_take_is_sent_again() -> None:
    bus = ChipBus()
    board = Pca9685(bus, a_map("pca9685"))
    pulses_us, on = np.full(N_JOINTS, 1500.0), np.ones(N_JOINTS, dtype=bool)
    bus.fails = lambda address: address == 0x41
    board.write(pulses_us, on)
    assert board.poll() is None
    bus.fails = lambda _: False
    assert board.poll() is not None
    assert (bus.pulses_us()[:18] > 0).all()


def test_thousands_of_hostile_readings_neither_crash_nor_move_anything() -> None:
    dice, reads = random.Random(2), 0

    def hostile(value: int) -> int:
        nonlocal reads
        reads += 1
        spoiled: list[int] = [*dice.randbytes(3), 0, 0x10, 0x20, 0xFF, value]
        return dice.choice(spoiled)

    bus = ChipBus()
    bus.spoils = hostile
    faults = set()
    while reads < 2_000:
        servos = _servos(bus)
        try:
            with servos:
                next_state(servos)
        except RobotFaultError as error:
            faults.add(str(error))
    assert faults
    assert not bus.pulses_us().any()


def test_a_chip_that_is_no_pca9685_and_a_bus_without_boards_are_faults_in_one_line() -> None:
    class Deaf(ChipBus):
        def i2c_rdwr(self, *messages: Any) -> None:
            if len(messages) > 1:
                super().i2c_rdwr(*messages)

    with pytest.raises(RobotFaultError, match="at 0x40 has lost its"):
        _servos(Deaf()).connect()
    with pytest.raises(RobotFaultError, match="board at 0x40"):
        _servos(ChipBus({})).connect()
    with pytest.raises(RobotFaultError, match="board at 0x41"):
        _servos(ChipBus({0x40: SimulatedPca9685()})).connect()


def test_a_bus_that_cannot_be_opened_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RobotFaultError, match="/dev/i2c-77"):
        open_i2c("/dev/i2c-77")
    monkeypatch.setitem(sys.modules, "smbus2", None)
    with pytest.raises(MissingExtraError, match="i2c"):
        open_i2c("1")


def test_chips_do_what_the_data_sheet_says() -> None:
    """The simulated chip, by which all of this is judged."""
    chip = SimulatedPca9685()
    chip.write(bytes([0xFE, 121]))
    assert chip.registers[0xFE] == 121, "asleep after a reset"
    chip.write(bytes([0x00, 0x20]))
    chip.write(bytes([0xFE, 50]))
    assert chip.registers[0xFE] == 121, "blocked while awake"
    chip.write(bytes([6, 0, 0, 0x33, 0x01, 0, 0, 0, 0x10]))
    assert chip.pulses_us()[0] == pytest.approx(307 * COUNT_US)
    assert chip.pulses_us()[1] == 0
    chip.write(bytes([0x00, 0x30]))
    assert chip.registers[0x00] == 0xB0, "a restart is possible"
    assert not chip.pulses_us().any()
    chip.write(bytes([0xFD, 0x10]))
    chip.write(bytes([0x00, 0x20]))
    assert not chip.pulses_us().any(), "all channels off"
    chip.reset()
    chip.write(bytes([6, 1, 2, 3, 4]))
    assert chip.registers[6:10] == bytes([4, 0, 0, 0x10]), "no auto-increment after a reset"
    bus = SimulatedI2c({0x40: chip, 0x41: SimulatedPca9685()})
    bus.transfer([I2cMessage(0x70, data=bytes([0x01, 0x00]))])
    assert chip.registers[0x01] == 0, "all of them answer at 0x70"
    bus.transfer([I2cMessage(0x00, data=b"\x06")])
    assert chip.registers[0x01] == 0x04
    with pytest.raises(OSError, match="Remote I/O error") as refused:
        bus.transfer([I2cMessage(0x42, 1)])
    assert refused.value.errno == errno.EREMOTEIO


# Boards in another process, behind a socket.

MESSAGES = st.lists(
    st.one_of(
        st.builds(I2cMessage, st.integers(0, 0x7F), st.integers(1, 300)),
        st.builds(I2cMessage, st.integers(0, 0x7F), st.just(0), st.binary(max_size=80)),
    ),
    max_size=5,
)


@given(MESSAGES)
def test_a_transaction_comes_back(messages: list[I2cMessage]) -> None:
    assert decode_transaction(encode_transaction(messages)) == messages


def test_registers_are_written_and_read() -> None:
    with pca9685_board() as board:
        bus = I2cSocket(board.path)
        assert byte_of(bus, 0x40, 0xFE) == 0x1E
        bus.i2c_rdwr(i2c_msg.write(0x41, [0xFE, 121]))
        assert byte_of(bus, 0x41, 0xFE) == 121
        assert byte_of(bus, 0x40, 0xFE) == 0x1E
        bus.i2c_rdwr(i2c_msg.write(0x40, [0x00, 0x30]))
        answer = i2c_msg.read(0x40, 5)
        bus.i2c_rdwr(i2c_msg.write(0x40, [0x02]), answer)
        assert bytes(answer) == bytes([0xE2, 0xE4, 0xE8, 0xE0, 0x00])
        with pytest.raises(OSError, match="Remote I/O error"):
            byte_of(bus, 0x42, 0)
        assert byte_of(bus, 0x40, 0) == 0x30, "the next transfer is as good as any"
        bus.close()
        with pytest.raises(OSError, match=r"."):
            byte_of(bus, 0x40, 0)


def test_boards_outlive_clients_that_leave_or_talk_nonsense() -> None:
    with pca9685_board() as board:
        whole = encode_transaction([I2cMessage(0x40, data=bytes([0x00, 0x30]))])
        for data in (whole[:4], random.Random(1).randbytes(50), b"\xff" * 300, whole):
            client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            client.connect(board.path)
            client.send(data)
            client.close()
        bus = I2cSocket(board.path)
        assert byte_of(bus, 0x40, 0x00) == 0x30
        bus.close()


def test_an_answer_that_does_not_come_ends_the_connection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexctl.backends.pwm.i2c_socket.TIMEOUT_S", 0.05)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(tmp_path / "i2c"))
    listener.listen()
    over = threading.Event()

    def serve() -> None:
        client = listener.accept()[0]
        over.wait(5)
        client.close()

    thread = threading.Thread(target=serve)
    thread.start()
    bus = I2cSocket(str(tmp_path / "i2c"))
    with pytest.raises(TimeoutError):
        byte_of(bus, 0x40, 0)
    with pytest.raises(OSError, match=r"."):
        bus.i2c_rdwr(i2c_msg.write(0x40, [0, 0]))
    over.set()
    thread.join()
    listener.close()


class LoggedBus(ChipBus):
    """Chips with a log of what is written, without the registers of questions."""

    def __init__(self) -> None:
        super().__init__()
        self.written: list[tuple[int, int, int]] = []

    def _transfer(self, messages: Sequence[I2cMessage]) -> bytes:
        self.written += [(one.address, one.data[0], len(one.data)) for one in messages if len(one.data) > 1]
        return super()._transfer(messages)


def test_a_pose_is_one_message_for_each_board() -> None:
    bus = LoggedBus()
    with _servos(bus) as servos:
        _power(servos, bus)
        servos.clock.tick()
        servos.clock.time.sleep(0.1)
        bus.written.clear()
        before = servos.counters.writes
        servos.write(JointTargets(servos.robot.stance_angles_rad + 0.01, servos.clock.now_s))
        wait_for(lambda: servos.counters.writes > before, 5.0, "the write never came", time=servos.clock.time)
        servos.clock.time.sleep(0.1)
        written = bus.written.copy()
    assert written[:2] == [(0x40, 6, 65), (0x41, 6, 9)]
    assert written == written[:2] * (len(written) // 2)


@pytest.mark.realtime
def test_a_simulated_robot_moves_as_the_pulses_say_and_outlasts_faults() -> None:
    simulated = SimServos(shipped(), realtime=True)
    faults = ("nack:0.02", "unplug@2", "replug@2.5", "reset@4")
    with pca9685_board(*faults, servos=simulated) as board, i2c_servos_on(board) as servos:
        requested_rad = servos.robot.stance_angles_rad + 0.05

        def within_reach(_: RobotState) -> bool:
            return np.allclose(simulated.read().joint_positions_rad, requested_rad, atol=0.03)

        until(servos, within_reach, offset_rad=0.05)
        np.testing.assert_allclose(board.pulses_us(), a_map("pca9685").raw(requested_rad), atol=2.5)
        assert "Remote I/O error" in str(until(servos, _unhealthy, offset_rad=0.05).fault)
        until(servos, lambda state: state.healthy, write=False)
        assert (board.pulses_us() > 0).all(), "a cable that comes back leaves the robot standing"
        assert "has lost its settings" in str(until(servos, _unhealthy, offset_rad=0.05).fault)
        until(servos, lambda _: not board.pulses_us().any(), offset_rad=0.05)
        assert board.report()["refused"] > 0


def _unhealthy(state: RobotState) -> bool:
    return not state.healthy


@pytest.mark.realtime
def test_transfers_take_no_less_than_their_bits() -> None:
    with pca9685_board(baud=10_000) as board:
        bus, began_s = I2cSocket(board.path), time.monotonic()
        byte_of(bus, 0x40, 0)  # four bytes
        assert time.monotonic() - began_s >= 0.0036
        bus.close()
