"""Hobby servos on a servo2040: bytes, staging before the relay, contacts, and what goes wrong."""

import os
import select
import tty
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.pwm.servo2040 import (
    COUNTS_PER_V,
    Servo2040,
    Servo2040Servos,
    checksum,
    decoded,
    encoded,
    find_reply,
    get_frame,
    parse_servo2040_port,
    set_frame,
)
from hexctl.control.guard import Guard
from hexctl.errors import InputError, RobotFaultError
from hexctl.testing.servo_conformance import move
from hexctl.time_source import WALL_TIME
from hexctl.types import FloatArray
from tests.backends.powering import HobbyServosConformance
from tests.backends.pwm.boards import a_map, memory_servo2040, servos_on
from tests.backends.standing import stand, until
from tests.robots import shipped

#: 1.5 A and 8.3 V in the fork's example.
FORK_REPLY = bytes.fromhex("C7 18 02 16 01 3E 06 F2")


def test_frames_are_those_of_the_description() -> None:
    assert set_frame(4, [1500]) == bytes.fromhex("D3 04 01 5C 0B")
    assert set_frame(7, [1007, 1012]) == bytes.fromhex("D3 07 02 6F 07 74 07")
    assert set_frame(26, [1]) == bytes.fromhex("D3 1A 01 01 00")
    assert get_frame(24, 2) == bytes.fromhex("C7 18 02")


def test_the_forks_example_is_read() -> None:
    assert find_reply(FORK_REPLY, 24, 2, checked=True) == [150, 830]
    assert find_reply(b"\x93\xc7" + FORK_REPLY, 24, 2, checked=True) == [150, 830]
    assert find_reply(FORK_REPLY[:-1], 24, 2, checked=True) is None
    assert find_reply(FORK_REPLY[:-1] + b"\xf3", 24, 2, checked=True) is None
    assert find_reply(FORK_REPLY, 24, 3, checked=False) is None


@given(st.lists(st.integers(0, 16383), max_size=28), st.integers(0, 28), st.binary(max_size=8))
def test_values_of_14_bits_come_back(values: list[int], start: int, noise: bytes) -> None:
    data = encoded(values)
    assert decoded(data) == values
    assert all(byte < 0x80 for byte in data)
    reply = get_frame(start, len(values)) + data
    if values:
        checked = reply + bytes([checksum(reply)])
        assert find_reply(noise + checked, start, len(values), checked=True) is not None
        assert find_reply(reply[:-1], start, len(values), checked=False) is None


class TestServo2040(HobbyServosConformance):
    tolerance_us, tolerance_rad = 0.6, 2e-3

    @pytest.fixture(autouse=True, params=["stock", "fork"])
    def board(self, request: pytest.FixtureRequest) -> Iterator[None]:
        with memory_servo2040(firmware=request.param) as self.running:
            yield

    def make(self) -> Servo2040Servos:
        made: Servo2040Servos = servos_on(self.running)
        return made

    def pulses_us(self) -> FloatArray:
        board = self.running.board
        return np.where(board.enabled & board.relay, board.pulses_us, 0.0)


class _Line(SerialLine):
    """A line that keeps what is written to it, and on which nothing is heard."""

    time = WALL_TIME

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.path = "/dev/ttyACM0"

    def write(self, packet: bytes, *, timeout_s: float = 0.02) -> None:
        self.written.append(packet)

    def read(self, deadline_s: float) -> bytes:
        asked = self.written[-1]
        values = asked + encoded([600] * asked[2])
        return values if asked[0] == 0xC7 else b""

    def discard(self) -> bool:
        return False


def test_a_pose_is_one_frame_below_64_bytes_and_staged_before_the_relay() -> None:
    line = _Line()
    outputs = {
        f"leg{leg}_{kind}": {"id": 17 - 3 * (leg - 1) - n}
        for leg in range(1, 7)
        for n, kind in enumerate(("coxa", "femur", "tibia"))
    }
    board = Servo2040(line, a_map("servo2040", **outputs))
    line.written.clear()
    pulses = np.linspace(1000.0, 1170.0, 18)
    first = np.arange(18) < 3
    board.begin(pulses, first)
    board.end()
    pose = bytes([0xD3, 0, 18]) + encoded([round(pulse) for pulse in pulses[::-1]])
    alone = bytes([0xD3, 0, 18]) + encoded([0] * 15 + [round(pulse) for pulse in pulses[2::-1]])
    assert line.written == [pose, bytes.fromhex("D31A010100"), alone, bytes.fromhex("D31A010000")]
    assert len(pose) == 39


@pytest.mark.parametrize("firmware", ["stock", "fork"])
def test_contacts_voltage_and_current_of_the_simulated_robot_are_read(firmware: str) -> None:
    from hexctl.backends.sim.servos import SimServos

    pwm_map = a_map("servo2040", leg1_tibia={"touch": 4}, leg5_tibia={"touch": 0})
    with (
        memory_servo2040(firmware=firmware, servos=SimServos(shipped()), pwm_map=pwm_map) as running,
        servos_on(running, pwm_map) as servos,
    ):
        state = until(servos, lambda state: state.foot_contacts is not None and state.foot_contacts.all())
        assert state.battery_v == pytest.approx(7.4, abs=0.01)
        lifted = servos.robot.stance_angles_rad.copy()
        lifted[1] += np.radians(30)  # the first femur
        move(servos, lifted, ticks=100)
        contacts, current = servos.read().foot_contacts, servos.read().current_a
        assert contacts is not None
        assert contacts.tolist() == [False, True, True, True, True, True]
        assert current is not None
        assert 0 < current < 36


def test_a_single_wrong_voltage_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    board = Servo2040(_Line(), a_map())
    sent = [7.4, 0.1, 7.4, 9.9, 7.3, 7.2]
    answers = iter([0] * 7 + [round(volts * COUNTS_PER_V), 0, 0] for volts in sent)
    monkeypatch.setattr(board, "_ask", lambda *_: next(answers))
    reports = [board.poll() for _ in sent]
    voltages_v = [report.voltage_v for report in reports if report is not None]
    assert voltages_v[2:] == pytest.approx([7.4, 7.4, 7.4, 7.3], abs=0.01)


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_one() -> None:
    class Late(_Line):
        late = b""

        def discard(self) -> bool:
            waited, self.late = bool(self.late), b""
            return waited

        def read(self, deadline_s: float) -> bytes:
            return self.late + super().read(deadline_s)

    line = Late()
    board = Servo2040(line, a_map())
    assert board.poll() is not None
    line.late = line.written[-1] + encoded([0] * line.written[-1][2])
    report = board.poll()
    assert report is not None
    assert np.array(report.contacts).all(), "none of an earlier moment"


def test_a_trip_stops_the_robot_until_its_torque_was_off() -> None:
    with memory_servo2040("trip:12.5@1", firmware="fork") as running, servos_on(running) as servos:
        board = running.board
        assert "12.5 A" in str(until(servos, lambda state: not state.healthy).fault)
        stand(servos, 10)
        assert not board.relay, "nothing is powered again by itself"
        servos.disable_torque()
        until(servos, lambda state: state.healthy, write=False)
        until(servos, lambda _: board.relay)


def test_garbled_replies_stop_nothing() -> None:
    with memory_servo2040("garble:0.2@0.5", firmware="fork") as running, Guard(servos_on(running)) as guard:
        stand(guard, 150)
        assert guard.stopped is None
        assert guard.link_counts["missed"] > 0


@pytest.mark.parametrize("faults", [("mute@1",), ("unplug@1", "replug@2.5")])
def test_a_board_that_falls_mute_is_a_fault_while_it_is(faults: tuple[str, ...]) -> None:
    with memory_servo2040(*faults) as running, servos_on(running) as servos:
        state = until(servos, lambda state: not state.healthy)
        assert "does not answer" in str(state.fault)
        assert state.foot_contacts is None
        assert state.age_s > 0.2, "what it was told is not what it does"
        if len(faults) == 2:
            until(servos, lambda state: state.healthy)


@pytest.mark.parametrize("noise", [b"\x00\xff\xc7" * 50, b"\xc7\x19\x01\xff\xff\xff", b"\xc7" * 500])
def test_a_device_that_talks_nonsense_is_no_board(noise: bytes) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    servos = Servo2040Servos(shipped(), pwm_map=a_map(), port=os.ttyname(slave))
    os.write(master, noise)
    with pytest.raises(RobotFaultError, match="no servo2040 answers"):
        servos.connect()
    asked = os.read(master, 100) if select.select([master], [], [], 0)[0] else b""
    assert asked in [get_frame(25, 1) * tries for tries in range(1, 5)], "nothing but questions was sent"
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("text", [None, "", "/dev/ttyACM0:115200"])
def test_a_port_that_is_none_is_refused(text: str | None) -> None:
    with pytest.raises(InputError, match="port: "):
        parse_servo2040_port(text)


@pytest.mark.parametrize("firmware", ["stock", "fork"])
def test_the_relay_is_off_before_the_first_targets_and_without_torque(firmware: str) -> None:
    with memory_servo2040(firmware=firmware) as running:
        with servos_on(running) as servos:
            until(servos, lambda _: servos.counters.reports > 3, write=False)
            assert not running.board.relay
            assert not servos.read().measured
            until(servos, lambda _: running.board.enabled.all())
            assert running.board.relay
            servos.disable_torque()
        assert not running.board.relay
