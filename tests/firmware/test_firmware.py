"""The sketch in `firmware/`, compiled for this computer: watchdog, pulses, sensors, damaged input, real time.

The contract's tests in `test_servo_board.py` and `test_mavlink_client.py` run on it too.
"""

import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mavlink.mavlink_client import MavlinkServos
from hexctl.cli.main import exit_code
from hexctl.robot.loader import load_robot_file
from hexctl.simulators.simulated_board import PseudoTerminal
from hexctl.testing import LegServosConformance
from hexctl.time_source import WALL_TIME
from hexctl.types import FloatArray
from tests.backends.mavlink.boards import fitting_file
from tests.firmware.boards import ARCHITECTURES, HERE, PASS_S, PINS_FEET, Firmware, compiled, decoded
from tests.firmware.driver import COUNT_US, LEAST_US, MOST_US, STANCE, TICK_S, Driver
from tests.robots import shipped

pytestmark = pytest.mark.slow


@pytest.fixture(params=ARCHITECTURES)
def driver(request: pytest.FixtureRequest) -> Driver:
    return Driver(architecture=request.param)


def test_silence_holds_after_a_fifth_of_a_second_and_releases_after_ten_seconds(driver: Driver) -> None:
    driver.override(STANCE + 100, times=10)
    held_s = TICK_S + driver.time_until(lambda: driver.firmware.counts()["expired"], 0.3)
    assert 0.2 < held_s <= 0.2 + 0.001 + 1e-6
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 100, abs=COUNT_US)
    released_s = held_s + driver.time_until(lambda: not driver.firmware.pulses_us().any(), 11)
    assert 10.0 < released_s <= 10.0 + TICK_S + 1e-6
    assert driver.firmware.level(driver.firmware.pin_oe) == 1
    driver.pass_time(2 * TICK_S)
    assert driver.newest("ACTUATOR_OUTPUT_STATUS").active == 0
    assert driver.firmware.counts()["released"] == 1


def test_heartbeats_of_the_commander_hold_the_pose_and_those_of_others_do_not(driver: Driver) -> None:
    driver.override(STANCE)
    for _ in range(12):
        driver.say(driver.encode(mavlink_messages.controller_heartbeat()))
        driver.pass_time(1.0)
    assert driver.firmware.pulses_us().all()
    for number in range(11):
        driver.say(Codec(254, 191).encode(mavlink_messages.controller_heartbeat(), number))
        driver.pass_time(1.0)
    assert not driver.firmware.pulses_us().any()


def test_what_waited_while_the_board_stood_still_moves_nothing(driver: Driver) -> None:
    driver.override(STANCE, times=5)
    late = [driver.encode(mavlink_messages.override(STANCE + 100, 1, 1)) for _ in range(10)]
    driver.now_s += 1.0
    driver.say(b"".join(late))
    counts = driver.firmware.counts()
    assert (counts["not_yet"], counts["expired"]) == (10, 1)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE, abs=COUNT_US)


def test_impossible_overrides_do_not_keep_the_robot_commanded(driver: Driver) -> None:
    driver.override(STANCE)
    driver.override(np.array([99.0, *STANCE[1:]]), times=15)
    counts = driver.firmware.counts()
    assert (counts["overrides"], counts["refused"] + counts["not_yet"], counts["expired"]) == (1, 15, 1)


def test_the_hardware_watchdog_runs_and_is_fed(driver: Driver) -> None:
    assert 0 < driver.firmware.watchdog_ms() <= 5000


def test_pulses_stay_within_limits_and_half_a_count_from_the_command(driver: Driver) -> None:
    driver.override(STANCE)
    for pulse in [100, 499, *range(500, 2501, 7), 2500, 2501, 5000]:
        driver.override(np.full(18, float(pulse)))
        made = driver.firmware.pulses_us()
        assert (made >= LEAST_US).all(), pulse
        assert (made <= MOST_US).all(), pulse
        wanted = min(max(pulse, LEAST_US), MOST_US)
        slack = COUNT_US if pulse <= LEAST_US + COUNT_US or pulse >= MOST_US - COUNT_US else COUNT_US / 2
        assert np.abs(made - wanted).max() <= slack + 1e-9, pulse


def test_each_channel_has_its_output_and_a_released_one_none(driver: Driver) -> None:
    driver.override(np.arange(1000.0, 1900.0, 50.0))
    assert driver.firmware.pulses_us() == pytest.approx(np.arange(1000, 1900, 50), abs=COUNT_US / 2)
    raw = np.full(18, 65535.0)
    raw[0], raw[17] = 0, 65534
    driver.override(raw)
    assert np.flatnonzero(driver.firmware.pulses_us() == 0).tolist() == [0, 17]


def test_no_servo_has_a_pulse_before_the_first_command(driver: Driver) -> None:
    driver.pass_time(1.0)
    assert driver.firmware.level(driver.firmware.pin_oe) == 1
    assert not driver.firmware.pulses_us().any()
    assert driver.newest("ACTUATOR_OUTPUT_STATUS").actuator[:18] == [1500.0] * 18


@pytest.mark.parametrize("number", [0, 1])
def test_a_chip_that_lost_its_power_releases_all_servos_until_they_are_commanded_anew(
    number: int, driver: Driver
) -> None:
    driver.override(STANCE, times=5)
    driver.firmware.lose_power(number)
    driver.override(STANCE, times=130)  # of a controller that has not heard of it
    assert not driver.firmware.pulses_us().any()
    assert "lost its power" in driver.newest("STATUSTEXT").text
    assert driver.newest("HEARTBEAT").system_status >= mavlink_messages.EMERGENCY
    driver.pass_time(1.5)
    assert not driver.firmware.pulses_us().any()
    assert driver.newest("HEARTBEAT").system_status == mavlink_messages.STANDBY
    driver.override(STANCE + 50, times=60)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 50, abs=COUNT_US)


def test_a_wire_that_breaks_is_a_fault_until_it_is_mended(driver: Driver) -> None:
    driver.override(STANCE, times=5)
    driver.firmware.answer(0, False)
    driver.override(STANCE + 50, times=30)
    assert "does not answer" in driver.newest("STATUSTEXT").text
    assert driver.newest("HEARTBEAT").system_status >= mavlink_messages.EMERGENCY
    driver.say(driver.encode(mavlink_messages.release(1, 1)))
    assert not driver.firmware.pulses_us().any(), "OE releases without I2C"
    driver.firmware.answer(0, True)
    driver.override(STANCE + 50, times=60)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 50, abs=COUNT_US)
    assert driver.newest("HEARTBEAT").system_status == mavlink_messages.ACTIVE


def test_foot_switches_and_the_battery_are_reported(driver: Driver) -> None:
    for leg, pin in enumerate(PINS_FEET):
        driver.firmware.press(pin, leg in (1, 4))
    driver.firmware.supply(1850)
    driver.pass_time(1.1)
    contacts = next(
        message
        for message in reversed(decoded(driver.frames, "NAMED_VALUE_INT"))
        if mavlink_messages.name_of(message) == "contacts"
    )
    assert contacts.value == 0b010010
    assert driver.newest("SYS_STATUS").voltage_battery == pytest.approx(7400, abs=5)


def test_a_full_line_drops_complete_frames_and_stops_nothing(driver: Driver) -> None:
    driver.firmware.fill(50)
    driver.override(STANCE + 20, times=100)
    assert driver.firmware.counts()["dropped"] >= 90
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 20, abs=COUNT_US)
    driver.firmware.fill(4096)
    driver.frames.clear()
    driver.override(STANCE, times=50)
    assert len(decoded(driver.frames, "ACTUATOR_OUTPUT_STATUS")) >= 49


@pytest.mark.parametrize(
    "garbage", [b"\xfd\xff\x00", b"\xfe\x09\x00", b"\xfd\x20\x01\x00\xfd\x09", b"\xfd" * 40]
)
def test_garbage_hides_no_good_frame(garbage: bytes, driver: Driver) -> None:
    driver.say(garbage)
    driver.override(STANCE + 20, times=40)
    counts = driver.firmware.counts()
    assert counts["overrides"] == 40, "late at most, behind what may be a frame of up to 280 bytes"
    assert (counts["lost"], counts["out_of_order"]) == (0, 0)


def test_random_input_moves_no_pulse_out_of_its_limits(tmp_path: Path) -> None:
    """With sanitizers of addresses and undefined behaviour; its first tenth has no override."""
    sanitizers = "-fsanitize=address,undefined", "-fno-sanitize-recover=all"
    program = compiled(tmp_path / "fuzz", HERE / "fuzz.cpp", "-O1", *sanitizers)
    done = subprocess.run([program, "7", "30000"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


# In real time, over a pseudo-terminal.


@contextmanager
def on_terminal(start_us: FloatArray) -> Iterator[tuple[str, Firmware]]:
    """Run the sketch at a pseudo-terminal meanwhile: the device, and the sketch."""
    terminal, stopping, firmware = PseudoTerminal(), threading.Event(), Firmware(start_us)

    def run() -> None:
        firmware.begin(WALL_TIME.now())
        while not stopping.is_set():
            data = terminal.receive(PASS_S)
            for frame in firmware.run(WALL_TIME.now(), data):
                terminal.send(frame)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield terminal.path, firmware
    finally:
        stopping.set()
        thread.join()
        terminal.close()


@pytest.mark.realtime
@pytest.mark.long
class TestOnTerminal(LegServosConformance):
    @pytest.fixture(autouse=True)
    def terminal(self, tmp_path: Path) -> Iterator[None]:
        self.servo_map = load_robot_file(fitting_file(tmp_path)).servo_map
        with on_terminal(self.servo_map.to_us(shipped().stance_angles_rad)) as (self.path, _):
            yield

    def make(self) -> LegServos:
        return MavlinkServos(shipped(), servo_map=self.servo_map, port=self.path)


@pytest.mark.realtime
def test_a_walk_of_the_command_moves_the_servos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = fitting_file(tmp_path)
    stance_us = load_robot_file(file).servo_map.to_us(shipped().stance_angles_rad)
    with on_terminal(stance_us) as (path, firmware):
        arguments = ["run", "--robot", str(file), "--backend", "mavlink", "--port", path, "--no-record"]
        assert exit_code([*arguments, "--duration", "3"]) == 0, capsys.readouterr()
        counts = firmware.counts()
    assert counts["overrides"] >= 140
    assert (counts["refused"], counts["malformed"], counts["not_yet"]) == (0, 0, 0)
