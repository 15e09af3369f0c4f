"""Hobby servos on Pololu Maestros: bytes of the guide, the serial timeout, errors, and what goes wrong."""

import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.maestro import MaestroServos, crc7, settings_of
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.errors import InputError, RobotFaultError
from hexctl.simulators.maestro_board import MaestroBoard, SimulatedMaestro
from hexctl.testing.family_conformance import running as running_board
from hexctl.testing.servo_conformance import move
from hexctl.types import FloatArray
from hexctl.waiting import wait_for
from tests.backends.powering import HobbyServosConformance
from tests.backends.pwm.boards import a_map, loses_poses, memory_board, nonsense_answers, servos_on
from tests.backends.standing import next_state, stand, until
from tests.robots import shipped

#: Ways to have eighteen channels.
WIRINGS: dict[str, dict[str, Any]] = {
    "mini24": {},
    "two mini12": {"board": {"model": "mini12", "devices": [12, 13], "crc": True}},
    "three micro6": {"board": {"model": "micro6", "devices": [1, 2, 3]}},
}


def maestro_map(**section: Any) -> PwmMap:
    return a_map("maestro", **section)


class TestMaestro(HobbyServosConformance):
    tolerance_us, tolerance_rad = 0.13, 1e-3

    @pytest.fixture(autouse=True, params=WIRINGS)
    def board(self, request: pytest.FixtureRequest) -> Iterator[None]:
        with memory_board(maestro_map(**WIRINGS[request.param])) as self.running:
            yield

    def make(self) -> MaestroServos:
        made: MaestroServos = servos_on(self.running)
        return made

    def pulses_us(self) -> FloatArray:
        pulses: FloatArray = self.running.board.pulses_us()
        return pulses


def test_commands_are_those_of_the_guide() -> None:
    compact, crc = settings_of(maestro_map()), settings_of(maestro_map(board={"crc": True}))
    assert compact.pose([2], [6000]) == bytes.fromhex("84 02 70 2E")
    assert compact.pose([3, 4], [0, 6000]) == bytes.fromhex("9F 02 03 00 00 70 2E")
    assert settings_of(maestro_map(board={"devices": [12]})).pose([0], [6000]) == bytes.fromhex(
        "AA 0C 04 00 70 2E"
    )
    assert crc7(bytes.fromhex("83 01")) == 0x17
    assert crc.pose([2], [6000])[:-1] == compact.pose([2], [6000])
    micros = settings_of(maestro_map(**WIRINGS["three micro6"]))
    assert micros.pose([5, 6], [6000, 6000]) == bytes.fromhex("AA 01 04 05 70 2E AA 02 04 00 70 2E")


def test_a_pose_of_eighteen_servos_is_one_command_of_39_bytes() -> None:
    pose = settings_of(maestro_map()).pose(range(18), [6000] * 18)
    assert len(pose) == 39
    assert pose[:3] == bytes([0x9F, 18, 0])


def test_the_simulated_board_does_what_the_guide_says() -> None:
    board = SimulatedMaestro(24, 12, crc=False)
    assert board.feed(bytes.fromhex("84 00 70 2E 90 00"), 0.0) == bytes([6000 & 0xFF, 6000 >> 8])
    assert board.feed(bytes.fromhex("AA 0D 10 00 AA 0C 10 00"), 0.1) == bytes([6000 & 0xFF, 6000 >> 8])
    board.pass_time(0.45)
    assert board.targets[0] == 6000
    board.pass_time(0.51)
    assert board.targets[0] == 0, "it went home"
    assert board.feed(b"\xa1\xa1", 0.52) == bytes([0x20, 0, 0, 0]), "reading clears the errors"
    board.feed(bytes.fromhex("84 00 70 2E 84 00"), 0.6)
    board.feed(bytes.fromhex("A1"), 0.6)
    assert board.targets[0] == 0, "a command that another one interrupts is an error, and all go home"
    with_crc = SimulatedMaestro(24, 12, crc=True)
    assert with_crc.feed(bytes([0xA1, crc7(b"\xa1")]), 0.0) == b"\0\0"
    assert with_crc.feed(bytes([0xA1, 0, 0xA1, crc7(b"\xa1")]), 0.0) == b"\x08\0"


def test_the_serial_timeout_is_tested_and_its_lack_is_said_with_what_to_set() -> None:
    with memory_board(maestro_map()) as running, servos_on(running) as servos:
        assert next_state(servos).warnings == ()
        before = running.board.counts["timeouts"]
        assert before > 0
        stand(servos, 100)
        assert running.board.counts["timeouts"] == before, "hexctl is never silent for so long"
    with memory_board(maestro_map(), "no-timeout") as running, servos_on(running) as servos:
        (warning,) = next_state(servos).warnings
        assert '"Timeout" to 0.40 s' in warning
        assert next_state(servos).healthy


def test_servos_that_hold_are_not_let_go_to_test_the_timeout() -> None:
    with memory_board(maestro_map(), "no-timeout") as running:
        with servos_on(running) as servos:
            until(servos, lambda _: (running.board.pulses_us() > 0).all())
        running.time.sleep(3.0)
        with servos_on(running) as servos:
            assert "was not tested" in next_state(servos).warnings[0]
            assert (running.board.pulses_us() > 0).all()


def test_a_program_that_is_silent_loses_its_pulses_to_the_timeout() -> None:
    with memory_board(maestro_map()) as running:
        with servos_on(running) as servos:
            until(servos, lambda _: (running.board.pulses_us() > 0).all())
        running.time.sleep(0.35)
        assert (running.board.pulses_us() > 0).all()
        running.time.sleep(0.1)
        assert not running.board.pulses_us().any()
        with servos_on(running) as servos:
            assert next_state(servos).warnings == (), "a board in its timeout shows that it has one"


DRIVER = """
import sys
from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.maestro import MaestroServos
from hexctl.backends.pwm.pulse_board import pwm_map_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import JointTargets

pwm_map = pwm_map_of(ServosSection.model_validate({"tibia": {"offset_deg": 40}}), "maestro")
with MaestroServos("ant", pwm_map=pwm_map, port=sys.argv[1]) as servos:
    while True:
        servos.clock.tick()
        servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
"""


@pytest.mark.realtime
def test_servos_go_limp_within_half_a_second_of_the_death_of_the_program() -> None:
    with running_board(MaestroBoard(MockServos(shipped()), maestro_map())) as board:
        program = subprocess.Popen([sys.executable, "-c", DRIVER, board.path])
        try:
            wait_for(lambda: (board.pulses_us() > 0).all(), 20.0, "nothing is powered")
            program.kill()
            killed_s = time.monotonic()
            wait_for(lambda: not board.pulses_us().any(), 5.0, "pulses stay")
            assert 0.3 < time.monotonic() - killed_s < 0.5
        finally:
            program.kill()
            program.wait()


def test_contacts_come_from_the_inputs_that_the_file_names() -> None:
    from hexctl.backends.sim.servos import SimServos

    touches = {f"leg{leg}_tibia": {"touch": 17 + leg} for leg in range(1, 7)}
    pwm_map = maestro_map(**touches)
    with memory_board(pwm_map, servos=SimServos(shipped())) as running, servos_on(running) as servos:
        until(servos, lambda state: state.foot_contacts is not None and state.foot_contacts.all())
        lifted = servos.robot.stance_angles_rad.copy()
        lifted[1] += np.radians(30)
        move(servos, lifted, ticks=100)
        assert servos.read().foot_contacts.tolist() == [False, True, True, True, True, True]
    with memory_board(maestro_map()) as running, servos_on(running) as servos:
        assert next_state(servos).foot_contacts is None


@pytest.mark.parametrize(
    ("fault", "named"), [("reset@2", "loss of power"), ("torn:0.3@2", "switched its servos off")]
)
def test_lost_pulses_are_a_fault_until_the_torque_was_off(fault: str, named: str) -> None:
    with memory_board(maestro_map(), fault) as running, servos_on(running) as servos:
        assert named in str(until(servos, lambda state: not state.healthy).fault)
        running.board._tears = 0.0
        stand(servos, 10)
        assert not running.board.pulses_us().any(), "nothing is powered again by itself"
        servos.disable_torque()
        until(servos, lambda state: state.healthy, write=False)
        until(servos, lambda _: (running.board.pulses_us() > 0).all())


def test_an_error_that_changes_no_pulse_is_only_a_warning() -> None:
    with memory_board(maestro_map(), "ignore") as running, servos_on(running) as servos:
        until(servos, lambda _: (running.board.pulses_us() > 0).all())
        running.board.boards[0].fail(0x08)
        assert "CRC error" in until(servos, lambda state: state.warnings).warnings[0]
        assert stand(servos, 50).healthy


def test_pulses_that_the_board_limits_are_named_with_their_channel() -> None:
    with memory_board(maestro_map(), "narrow") as running, servos_on(running) as servos:
        warned = until(servos, lambda state: state.warnings, offset_rad=0.1)
        assert "limits pulses of channel " in warned.warnings[0]
        assert warned.healthy
        stand(servos, 200, 0.1)
        running.unplugged = True
        until(servos, lambda state: not state.healthy)
        running.unplugged = False
        until(servos, lambda state: state.healthy, write=False)
        said = stand(servos, 200, 0.1).warnings
        assert warned.warnings[0] in said
        assert len(set(said)) == len(said), "each is said once, after a lost port too"


def test_lost_poses_stop_nothing_and_are_no_limits() -> None:
    with memory_board(maestro_map()) as running, servos_on(running) as servos:
        until(servos, lambda _: (running.board.pulses_us() > 0).all())
        loses_poses(running)
        for tick in range(300):
            state = stand(servos, 1, 0.1 * np.sin(0.1 * tick))
            assert (state.fault, state.warnings) == (None, ())


def test_garbled_answers_stop_nothing() -> None:
    with memory_board(maestro_map(), "garble:0.2@0.5") as running, servos_on(running) as servos:
        assert all(stand(servos, 1).healthy for _ in range(200))
        assert servos.link_counts["missed"] > 0


@pytest.mark.parametrize("faults", [("mute@2",), ("unplug@2", "replug@3.5")])
def test_a_board_that_falls_mute_is_a_fault_while_it_is(faults: tuple[str, ...]) -> None:
    with memory_board(maestro_map(), *faults) as running, servos_on(running) as servos:
        assert "does not answer" in str(until(servos, lambda state: not state.healthy).fault)
        if len(faults) == 2:
            assert not running.board.pulses_us().any(), "its timeout ended them"
            until(servos, lambda state: "serial timeout" in str(state.fault))
            assert not running.board.pulses_us().any(), "no servo starts again by itself"


def test_a_lost_port_is_reopened_and_the_legs_are_powered_one_after_the_other() -> None:
    with memory_board(maestro_map()) as running, servos_on(running) as servos:
        until(servos, lambda _: (running.board.pulses_us() > 0).all())
        running.unplugged = True
        assert "was lost" in str(until(servos, lambda state: not state.healthy).fault)
        stand(servos, 30)
        running.unplugged = False
        until(servos, lambda state: state.healthy, write=False)
        assert not running.board.pulses_us().any(), "its timeout ended them"
        seen = {int((running.board.pulses_us() > 0).sum()) for _ in range(100) if stand(servos, 1)}
        assert seen == {0, 3, 6, 9, 12, 15, 18}


@pytest.mark.parametrize(
    ("faults", "options", "section", "named"),
    [
        (("mute",), {}, {}, "no Maestro answers"),
        (("crc",), {}, {}, "crc"),
        ((), {"baud": 38_400}, {}, "no Maestro answers"),
        ((), {}, {"board": {"devices": [13]}}, "device number 13"),
        ((), {"model": "mini18"}, {"leg6_tibia": {"id": 20}}, "channel 20"),
    ],
)
def test_a_board_that_does_not_fit_the_file_is_named_at_the_start(
    faults: tuple[str, ...], options: dict[str, Any], section: dict[str, Any], named: str
) -> None:
    usual = {**section, "board": {}}
    with memory_board(maestro_map(**usual), *faults, **options) as running:
        servos = servos_on(running, maestro_map(**section))
        with pytest.raises(RobotFaultError, match=named):
            servos.connect()


def test_a_board_at_a_uart_takes_the_speed_of_the_line_from_the_first_aa() -> None:
    with memory_board(maestro_map(), baud=115_200) as running, servos_on(running) as servos:
        assert next_state(servos).healthy


@pytest.mark.parametrize(
    ("section", "named"),
    [
        ({"board": {"crcc": True}}, r"servos\.board: unknown key crcc.*'crc'"),
        ({"board": {"devices": [128]}}, "devices"),
        ({"board": {"devices": [12, 12]}}, "each number once"),
        ({"board": {"model": "mini12"}}, "12 outputs; allowed: at least 18"),
        ({"leg1_coxa": {"id": 24}}, r"leg1_coxa\.id: got 24; allowed: 0 to 23"),
        ({"leg1_tibia": {"touch": 20}}, "leg2_tibia: got no touch"),
    ],
)
def test_a_section_that_no_maestro_can_have_is_refused(section: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        maestro_map(**section)


def test_a_speed_at_which_a_pose_takes_too_long_is_refused() -> None:
    with pytest.raises(InputError, match="9600 baud, at which a pose of 39 bytes takes 41 of 20 ms"):
        MaestroServos(shipped(), pwm_map=maestro_map(), port="/dev/ttyUSB0:9600")


@pytest.mark.parametrize("noise", [b"\x00\xff\xc7" * 50, b"\xff\xff", b"SSC32-V2.50USB\r"])
def test_a_device_that_talks_nonsense_is_no_board(noise: bytes) -> None:
    asked = nonsense_answers(MaestroServos, maestro_map(), noise)
    assert set(asked) <= {0xA1, 0xAA, 12, 0x21}, "nothing but questions was sent"


@given(st.binary(max_size=80), st.booleans())
def test_no_bytes_break_the_simulated_board(data: bytes, crc: bool) -> None:
    board = SimulatedMaestro(18, 12, crc=crc)
    board.feed(data, 0.0)
    assert len(board.targets) == 18
