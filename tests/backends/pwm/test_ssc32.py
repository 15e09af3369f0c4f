"""Hobby servos on an SSC-32: text and binary commands, firmware without binary, and what goes wrong."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.backends.pwm.ssc32 import Ssc32Servos, binary_move, text_move
from hexctl.errors import InputError, RobotFaultError
from hexctl.simulators.ssc32_board import SimulatedSsc32
from hexctl.types import FloatArray
from tests.backends.bus.boards import MemoryDevice
from tests.backends.powering import HobbyServosConformance
from tests.backends.pwm.boards import a_map, loses_poses, memory_board, nonsense_answers, servos_on
from tests.backends.standing import stand, until
from tests.robots import shipped


def ssc32_map(**section: Any) -> PwmMap:
    return a_map("ssc32", **section)


def servos_at(board: MemoryDevice[Any], baud: int) -> Ssc32Servos:
    """Servos of the controller's end at a speed, not connected."""
    port, clock = f"{board.path}:{baud}", board.time.clock()
    return Ssc32Servos(shipped(), pwm_map=ssc32_map(), port=port, clock=clock)


class TestSsc32(HobbyServosConformance):
    tolerance_us, tolerance_rad = 0.6, 0.017  # pulses are read back in tens of a microsecond

    @pytest.fixture(autouse=True, params=[("ssc32u", 115_200), ("ssc32", 115_200), ("ssc32u", 38_400)])
    def board(self, request: pytest.FixtureRequest) -> Iterator[None]:
        model, self.baud = request.param
        with memory_board(ssc32_map(), model=model, baud=self.baud) as self.running:
            yield

    def make(self) -> Ssc32Servos:
        return servos_at(self.running, self.baud)

    def pulses_us(self) -> FloatArray:
        pulses: FloatArray = self.running.board.pulses_us()
        return pulses


def test_commands_are_those_of_the_guides() -> None:
    assert text_move({5: 1500, 31: 0}) == b"#5P1500#31P0\r"
    assert binary_move({0: 1500, 3: 750}) == bytes.fromhex("80 05 DC 83 02 EE A1 00 00")
    assert len(binary_move(dict.fromkeys(range(18), 1500))) == 57
    assert len(text_move(dict.fromkeys(range(14, 32), 1500))) == 145


def test_the_simulated_board_does_what_the_guides_say() -> None:
    board = SimulatedSsc32("SSC32-V2.50USB", is_binary=True)
    assert board.feed(b"ver\r", 0.0) == b"SSC32-V2.50USB\r"
    assert board.feed(b"#5 P1500\r QP5\r", 0.0) == bytes([150])
    assert board.feed(b"#5P2000T1000\r", 1.0) == b""
    assert board.feed(b"QP5\rQ\r", 1.5) == bytes([175]) + b"+"
    assert board.feed(b"QP5\rQ\r", 2.0) == bytes([200]) + b"."
    assert board.feed(bytes.fromhex("85 05 DC 86 05 DC"), 2.0) == b""
    assert board.pulses_us(2.0)[5] == 2000, "a group waits for its time"
    board.feed(bytes.fromhex("A1 00 00"), 2.0)
    assert board.pulses_us(2.0)[[5, 6]].tolist() == [1500, 1500]
    board.feed(b"#5P0\r#99P1500\r#6P9000\r", 2.0)
    assert board.pulses_us(2.0)[[5, 6]].tolist() == [0, 2500]
    older = SimulatedSsc32("SSC32-1.06XE", is_binary=False)
    assert older.feed(bytes.fromhex("85 05 DC A1 00 00 0D") + b"QP5\r", 0.0) == bytes([0])


@pytest.mark.parametrize(("model", "is_binary"), [("ssc32u", True), ("ssc32", False)])
def test_poses_are_binary_if_the_firmware_has_it(model: str, is_binary: bool) -> None:
    with memory_board(ssc32_map(), model=model) as running, servos_on(running) as servos:
        until(servos, lambda _: (running.board.pulses_us() > 0).all())
        board = servos._thread._device
        assert board.is_binary is is_binary
        assert board.firmware.startswith("SSC32-")
        assert running.board.counts["garbage"] == (0 if is_binary else 1)


def test_text_that_is_too_slow_is_a_fault_with_what_to_set() -> None:
    with (
        memory_board(ssc32_map(), model="ssc32", baud=38_400) as running,
        servos_at(running, 38_400) as servos,
    ):
        fault = str(until(servos, lambda state: not state.healthy).fault)
        assert "no binary commands" in fault
        assert "38400 baud, at which a pose of 145 bytes takes 38 of 20 ms; allowed: 115200" in fault
        stand(servos, 20)
        assert not running.board.pulses_us().any()


def test_lost_pulses_are_a_fault_until_the_torque_was_off() -> None:
    with memory_board(ssc32_map(), "reset@3") as running, servos_on(running) as servos:
        assert "loss of power" in str(until(servos, lambda state: not state.healthy).fault)
        assert not servos.holds
        stand(servos, 10)
        assert not running.board.pulses_us().any(), "nothing is powered again by itself"
        servos.disable_torque()
        until(servos, lambda state: state.healthy, write=False)
        until(servos, lambda _: (running.board.pulses_us() > 0).all())


def test_lost_poses_stop_nothing() -> None:
    with memory_board(ssc32_map()) as running, servos_on(running) as servos:
        until(servos, lambda _: (running.board.pulses_us() > 0).all())
        loses_poses(running)
        assert all(stand(servos, 1, 0.1 * np.sin(0.1 * tick)).healthy for tick in range(300))


def test_pulses_of_another_program_are_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    with memory_board(ssc32_map()) as running, servos_on(running) as servos:
        until(servos, lambda _: (running.board.pulses_us() > 0).all())
        monkeypatch.setattr(running.board.board, "_move", lambda *_: None)  # another one's, all the time
        fault = until(servos, lambda state: not state.healthy, offset_rad=0.2).fault
        assert "something else" in str(fault)
        assert servos.powered.all(), "its servos hold, and a person at the robot must know it"
        servos.disable_torque()
        until(servos, lambda _: not servos.holds, write=False)


@pytest.mark.parametrize("fault", ["garble:0.2@2", "torn:0.1@2"])
def test_a_bad_line_stops_nothing_that_holds(fault: str) -> None:
    with memory_board(ssc32_map(), fault) as running, servos_on(running) as servos:
        until(servos, lambda _: (running.board.pulses_us() > 0).all())
        assert all(stand(servos, 1).healthy for _ in range(200))


@pytest.mark.parametrize("faults", [("mute@2",), ("unplug@2", "replug@3.5")])
def test_a_board_that_falls_mute_is_a_fault_while_it_is(faults: tuple[str, ...]) -> None:
    with memory_board(ssc32_map(), *faults) as running, servos_on(running) as servos:
        assert "does not answer" in str(until(servos, lambda state: not state.healthy).fault)
        assert (running.board.pulses_us() > 0).all(), "its last pulses stay"
        if len(faults) == 2:
            until(servos, lambda state: state.healthy)


def test_a_lost_port_is_reopened_and_the_robot_stands_meanwhile() -> None:
    with memory_board(ssc32_map()) as running, servos_on(running) as servos:
        until(servos, lambda _: (running.board.pulses_us() > 0).all())
        running.unplugged = True
        assert "was lost" in str(until(servos, lambda state: not state.healthy).fault)
        running.unplugged = False
        until(servos, lambda state: state.healthy)
        assert (running.board.pulses_us() > 0).all()


@pytest.mark.parametrize(("faults", "baud"), [(("mute",), 115_200), ((), 38_400), (("garble:1",), 115_200)])
def test_a_port_without_the_board_at_its_speed_is_named(faults: tuple[str, ...], baud: int) -> None:
    with memory_board(ssc32_map(), *faults, baud=baud) as running:
        servos = servos_on(running)
        with pytest.raises(RobotFaultError, match=r"no SSC-32 answers on .* at 115200 baud"):
            servos.connect()


@pytest.mark.parametrize(
    ("section", "named"),
    [
        ({"leg1_coxa": {"id": 32}}, r"leg1_coxa\.id: got 32; allowed: 0 to 31"),
        ({"leg1_tibia": {"touch": 0}}, "allowed: no touch with ssc32"),
        ({"tibia": {"max_us": 2600}}, "max_us 2600"),
        ({"board": {"crc": True}}, "allowed: no keys with ssc32"),
    ],
)
def test_a_section_that_no_ssc32_can_have_is_refused(section: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        ssc32_map(**section)


def test_the_speed_of_a_new_board_is_refused_with_one_that_fits() -> None:
    with pytest.raises(
        InputError, match="9600 baud, at which a pose of 57 bytes takes 59 of 20 ms; allowed: 38400"
    ):
        Ssc32Servos(shipped(), pwm_map=ssc32_map(), port="/dev/ttyUSB0:9600")


@pytest.mark.parametrize("noise", [b"\x00\xff\xc7" * 50, b"\xa1\x00", b"SSC3\r"])
def test_a_device_that_talks_nonsense_is_no_board(noise: bytes) -> None:
    asked = nonsense_answers(Ssc32Servos, ssc32_map(), noise)
    assert not asked.replace(b"VER\r", b""), "nothing but questions was sent"


@given(
    st.lists(st.one_of(st.binary(max_size=20), st.sampled_from([b"#1P", b"QP", b"T9", b"\r"]))), st.booleans()
)
def test_no_bytes_break_the_simulated_board(parts: list[bytes], is_binary: bool) -> None:
    board = SimulatedSsc32("SSC32-1.06XE", is_binary=is_binary)
    board.feed(b"".join(parts), 0.0)
    assert board.pulses_us(1.0).max() <= 2500
