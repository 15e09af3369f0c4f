"""Transactions over a socket, and the simulated boards behind it, which move a robot."""

import random
import socket
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from smbus2 import i2c_msg

from hexctl.backends.pwm.i2c_socket import I2cMessage, I2cSocket, decode_transaction, encode_transaction
from tests.backends.pwm.boards import a_map, i2c_servos_on, pca9685_board
from tests.backends.pwm.i2c import byte_of
from tests.backends.standing import until
from tests.robots import shipped

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


@pytest.mark.realtime
def test_a_simulated_robot_moves_as_the_pulses_say_and_outlasts_faults() -> None:
    from hexctl.backends.sim.servos import SimServos

    simulated = SimServos(shipped(), realtime=True)
    faults = ("nack:0.02", "unplug@2", "replug@2.5", "reset@4")
    with pca9685_board(*faults, servos=simulated) as board, i2c_servos_on(board) as servos:
        wanted, comes = servos.robot.stance_angles_rad + 0.05, partial(until, servos, offset_rad=0.05)
        until(
            servos,
            lambda _: np.allclose(simulated.read().joint_positions_rad, wanted, atol=0.03),
            offset_rad=0.05,
        )
        np.testing.assert_allclose(board.pulses_us(), a_map("pca9685").raw(wanted), atol=2.5)
        assert "Remote I/O error" in str(comes(lambda state: not state.healthy).fault)
        comes(lambda state: state.healthy, write=False)
        assert (board.pulses_us() > 0).all(), "a cable that comes back leaves the robot standing"
        assert "has lost its settings" in str(comes(lambda state: not state.healthy).fault)
        comes(lambda _: not board.pulses_us().any())
        assert board.report()["refused"] > 0


@pytest.mark.realtime
def test_transfers_take_no_less_than_their_bits() -> None:
    with pca9685_board(bits_per_s=10_000) as board:
        bus, began_s = I2cSocket(board.path), time.monotonic()
        byte_of(bus, 0x40, 0)  # four bytes
        assert time.monotonic() - began_s >= 0.0036
        bus.close()
