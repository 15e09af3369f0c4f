"""Rules of the sketch in `firmware/` that protect people and servos, one by one."""

import numpy as np
import pytest

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.types import FloatArray
from tests.firmware.boards import ARCHITECTURES, PIN_OE, PINS_FEET, Firmware
from tests.firmware.driver import COUNT_US, LEAST_US, MOST_US, STANCE, TICK_S, Driver

pytestmark = pytest.mark.slow

KEY = bytes(range(32))


@pytest.fixture(params=ARCHITECTURES)
def driver(request: pytest.FixtureRequest) -> Driver:
    return Driver(architecture=request.param)


def reported_us(driver: Driver) -> list[float]:
    """Pulses of the newest report."""
    return list(driver.newest("ACTUATOR_OUTPUT_STATUS").actuator[:18])


# Signatures, and frames among garbage.


def test_a_board_without_a_key_refuses_signed_overrides(driver: Driver) -> None:
    signing = Codec(255, 191, signing_key=KEY)
    for sequence in range(10):
        driver.say(signing.encode(mavlink_messages.override(STANCE, 1, 1), sequence))
        driver.pass_time(TICK_S)
    assert not driver.firmware.pulses_us().any()
    assert driver.firmware.counts()["malformed"] == 1
    driver.override(STANCE, times=20)
    assert driver.firmware.pulses_us().all()


def test_a_damaged_signed_frame_hides_no_good_one(driver: Driver) -> None:
    frame = bytearray(driver.encode(mavlink_messages.override(STANCE, 1, 1)))
    frame[2] |= 1  # now signed, as it says, and its checksum is wrong
    driver.say(bytes(frame) + bytes(13))
    driver.override(STANCE, times=5)
    assert driver.firmware.counts()["overrides"] == 5


def test_each_run_of_damaged_frames_is_counted_once(driver: Driver) -> None:
    for number in (1, 2):
        frame = bytearray(driver.encode(mavlink_messages.override(STANCE, 1, 1)))
        frame[2] = 2  # a flag that nobody knows
        driver.say(bytes(frame) + b"noise" * 100)
        driver.override(STANCE, times=5)
        counts = driver.firmware.counts()
        assert (counts["malformed"], counts["overrides"]) == (number, 5 * number)


# Limits.


def test_reports_and_counters_show_what_a_limit_changed(driver: Driver) -> None:
    for number, channel in enumerate((0, 17), start=1):
        wanted = STANCE.copy()
        wanted[channel] = 400 if channel else 2600
        driver.override(wanted)
        assert reported_us(driver)[channel] == (LEAST_US if channel else MOST_US)
        assert driver.firmware.counts()["clipped"] == number


def test_an_impossible_pulse_changes_no_channel(driver: Driver) -> None:
    driver.override(STANCE)
    for pulse in (99.0, 5001.0):
        driver.override(np.array([*np.full(17, 1700.0), pulse]))
        assert reported_us(driver) == STANCE.tolist()
        assert driver.firmware.pulses_us() == pytest.approx(STANCE, abs=COUNT_US)
    assert driver.firmware.counts()["refused"] == 2


def test_each_channel_keeps_its_own_limits_between_counts_of_the_chips() -> None:
    limits = [(1000 + channel, 1900 + channel) for channel in range(18)]
    driver = Driver(limits_us=limits)
    for pulse in (100.0, 5000.0):
        driver.override(np.full(18, pulse))
        made = driver.firmware.pulses_us()
        for channel, (least, most) in enumerate(limits):
            assert least <= made[channel] <= most
            assert min(abs(made[channel] - least), abs(made[channel] - most)) < COUNT_US


def test_pulses_come_as_near_to_50_a_second_as_a_prescaler_can() -> None:
    firmware = Firmware(STANCE)
    for oscillator_hz in range(23_000_000, 27_000_000, 50_000):
        error_hz = [
            abs(oscillator_hz / 4096 / (firmware.prescale(oscillator_hz) + 1 + step) - 50)
            for step in (-1, 0, 1)
        ]
        assert error_hz[1] == min(error_hz), oscillator_hz


def test_a_channel_that_an_override_does_not_name_stays(driver: Driver) -> None:
    """Zero on channels 9 to 18: MAVLink cuts trailing zeros off."""
    driver.override(STANCE)
    driver.override(np.array([1700.0] * 8 + [0.0] * 10))
    assert reported_us(driver) == [1700.0] * 8 + [1500.0] * 10
    assert driver.firmware.counts()["refused"] == 0


# Commanders, losses and silence.


def other(driver: Driver, system: int, pulses: FloatArray, component: int = 191) -> None:
    """Let another controller command once."""
    driver.say(Codec(system, component).encode(mavlink_messages.override(pulses, 1, 1), 0))


def test_a_second_controller_waits_until_the_first_is_silent(driver: Driver) -> None:
    driver.override(STANCE, times=5)
    began_s, driver.frames = driver.now_s - TICK_S, []
    second = Codec(254, 191)
    executed = driver.firmware.counts()["overrides"]
    sequence = 0
    while driver.firmware.counts()["overrides"] == executed:
        assert driver.now_s - began_s < 5.0
        driver.say(second.encode(mavlink_messages.override(STANCE + 50, 1, 1), sequence % 256))
        driver.pass_time(TICK_S)
        sequence += 1
    assert driver.now_s - began_s == pytest.approx(2.5 + 0.3, abs=3 * TICK_S)
    said = driver.all("STATUSTEXT")
    assert 2 <= len(said) <= 3, "at most once a second"
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 50, abs=COUNT_US)


def test_another_program_of_the_same_computer_is_another_controller(driver: Driver) -> None:
    driver.override(STANCE)
    other(driver, 255, STANCE + 50, component=190)
    assert driver.firmware.counts()["of_others"] == 1
    assert driver.firmware.pulses_us() == pytest.approx(STANCE, abs=COUNT_US)


def test_a_crowd_does_not_take_the_place_of_the_commander(driver: Driver) -> None:
    driver.override(STANCE, times=50)
    for system in range(1, 30):
        other(driver, system, STANCE + 50)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE, abs=COUNT_US)
    driver.override(STANCE + 20)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 20, abs=COUNT_US)


def test_a_newcomer_does_not_take_the_place_of_a_silent_commander(driver: Driver) -> None:
    """It would keep the servos driven by its heartbeats."""
    driver.override(STANCE)
    driver.pass_time(6.0)
    newcomer = Codec(9, 191)
    for sequence in range(5):
        driver.say(newcomer.encode(mavlink_messages.controller_heartbeat(), sequence))
        driver.pass_time(1.0)
    assert not driver.firmware.pulses_us().any()


def test_who_receives_keeps_its_place_in_a_crowd(driver: Driver) -> None:
    driver.override(STANCE)
    watchers = {system: Codec(system, 191) for system in range(1, 8)}
    board_ms = driver.newest("ACTUATOR_OUTPUT_STATUS").time_usec // 1000
    for watcher in watchers.values():
        driver.say(watcher.encode(mavlink_messages.controller_heartbeat(board_ms=board_ms), 0))
    driver.pass_time(1.0)
    for number in (1, 2):
        driver.say(Codec(100 + number, 191).encode(mavlink_messages.controller_heartbeat(), 0))
        assert driver.firmware.counts()["crowded_out"] == number
    driver.pass_time(2.0)
    driver.say(Codec(103, 191).encode(mavlink_messages.controller_heartbeat(), 0))
    assert driver.firmware.counts()["crowded_out"] == 2


def test_after_a_silence_overrides_count_once_they_have_come_for_three_tenths_of_a_second(
    driver: Driver,
) -> None:
    driver.override(STANCE, times=5)
    driver.pass_time(0.3)
    driver.override(STANCE + 50, times=14)
    assert driver.firmware.counts()["not_yet"] == 14
    driver.override(STANCE + 50, times=3)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 50, abs=COUNT_US)
    driver.override(STANCE, times=50)
    assert driver.newest("HEARTBEAT").system_status == mavlink_messages.ACTIVE
    driver.pass_time(0.3)
    assert driver.firmware.counts()["expired"] == 2


def test_who_was_present_long_ago_is_not_present(driver: Driver) -> None:
    board_ms = driver.newest("ACTUATOR_OUTPUT_STATUS").time_usec // 1000
    driver.say(driver.encode(mavlink_messages.controller_heartbeat(board_ms=board_ms)))
    driver.override(STANCE, times=5)
    driver.pass_time(0.3)
    driver.override(STANCE + 50)
    assert driver.firmware.counts()["not_yet"] == 1
    assert driver.firmware.pulses_us() == pytest.approx(STANCE, abs=COUNT_US)


def test_each_frame_counts_once(driver: Driver) -> None:
    for _ in range(60):
        frame = driver.encode(mavlink_messages.override(STANCE, 1, 1))
        driver.say(frame + frame)
        driver.pass_time(TICK_S)
    counts = driver.firmware.counts()
    assert (counts["overrides"], counts["out_of_order"], counts["lost"]) == (60, 60, 0)


def test_late_frames_never_count_while_a_stream_goes_on(driver: Driver) -> None:
    driver.override(STANCE, times=5)
    for number in range(1, 61):
        late = mavlink_messages.override(STANCE + 100, 1, 1)
        driver.say(driver.codec.encode(late, driver.sequence - 3))
        assert driver.firmware.counts()["out_of_order"] == number
        driver.override(STANCE)
    assert driver.firmware.counts()["overrides"] == 65


def test_a_commander_that_returns_keeps_its_pose_held(driver: Driver) -> None:
    driver.override(STANCE)
    driver.pass_time(6.0)
    for _ in range(8):
        driver.say(driver.encode(mavlink_messages.controller_heartbeat()))
        driver.pass_time(1.0)
    assert driver.firmware.pulses_us().all()


def test_a_controller_that_restarts_is_obeyed_after_a_silence(driver: Driver) -> None:
    driver.override(STANCE, times=100)
    driver.pass_time(0.6)
    driver.sequence = 50
    driver.say(driver.encode(mavlink_messages.release(1, 1)))
    driver.pass_time(TICK_S)
    assert not driver.firmware.pulses_us().any()


def test_after_a_release_a_silent_commander_has_no_place(driver: Driver) -> None:
    driver.override(STANCE)
    driver.pass_time(10.1)
    for system in range(1, 9):
        driver.say(Codec(system, 191).encode(mavlink_messages.controller_heartbeat(), 0))
    assert driver.firmware.counts()["crowded_out"] == 0


def test_a_new_commander_has_to_come_for_long_enough_itself_after_a_silence(driver: Driver) -> None:
    """Its overrides may all be late ones, although those of the commander before had been steady."""
    driver.override(STANCE, times=5)
    driver.pass_time(0.3)
    refused = np.array([99.0, *STANCE[1:]])  # keeps the stream going, and executes nothing
    driver.override(refused, times=20)
    driver.say(driver.encode(mavlink_messages.controller_heartbeat(mavlink_messages.POWEROFF)))
    second = Codec(254, 191)
    driver.say(second.encode(mavlink_messages.override(STANCE + 50, 1, 1), 0))
    driver.pass_time(TICK_S)
    assert driver.firmware.counts()["not_yet"] >= 1
    assert driver.firmware.pulses_us() == pytest.approx(STANCE, abs=COUNT_US)


def test_losses_do_not_stop_a_stream_that_never_paused(driver: Driver) -> None:
    """Sequence numbers count modulo 256, for as long as a controller sends."""
    driver.override(STANCE, times=300)
    assert (
        driver.firmware.counts() | {"overrides": 300, "lost": 0, "out_of_order": 0}
        == driver.firmware.counts()
    )
    for _ in range(3):
        driver.sequence += 100
        driver.override(STANCE, times=2)
    assert driver.firmware.counts()["overrides"] == 306
    late = driver.codec.encode(mavlink_messages.override(STANCE + 50, 1, 1), driver.sequence - 100 & 255)
    driver.say(late)
    driver.pass_time(TICK_S)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE, abs=COUNT_US)
    assert driver.firmware.counts()["out_of_order"] == 1


def test_a_report_names_a_held_pose_and_a_fault_immediately(driver: Driver) -> None:
    driver.override(STANCE, times=5)
    driver.pass_time(1.3)
    assert driver.newest("HEARTBEAT").system_status == mavlink_messages.CRITICAL
    driver.override(STANCE, times=30)
    driver.firmware.answer(1, False)
    began_s = driver.now_s
    driver.frames.clear()
    driver.override(STANCE, times=27)  # a check of the chips, and one more tick
    assert driver.newest("HEARTBEAT").system_status >= mavlink_messages.EMERGENCY, driver.now_s - began_s
    said = [each for each in driver.frames if each[7] == 253]
    assert len(said) == 1, "said once, not at each tick"


def test_the_clock_of_the_processor_may_return_to_zero() -> None:
    driver = Driver(begins_s=2**32 / 1e6 - 1.0)
    driver.override(STANCE, times=100)
    counts = driver.firmware.counts()
    assert (counts["overrides"], counts["expired"], counts["not_yet"]) == (100, 0, 0)
    times_us = [each.time_usec for each in driver.all("ACTUATOR_OUTPUT_STATUS")]
    assert times_us == sorted(times_us)


# Chips.


@pytest.mark.parametrize("chip", [0, 1])
def test_pulses_that_a_chip_did_not_take_are_written_again(chip: int, driver: Driver) -> None:
    driver.override(STANCE, times=3)
    driver.firmware.answer(chip, False)
    driver.say(driver.encode(mavlink_messages.override(STANCE + 50, 1, 1)))
    driver.firmware.answer(chip, True)
    driver.pass_time(3 * TICK_S)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 50, abs=COUNT_US)


def test_outputs_stay_off_until_the_chips_have_the_pulses(driver: Driver) -> None:
    pin = driver.firmware.pin_oe
    assert not driver.firmware.driven_low(pin), "high before it is an output"
    driver.firmware.answer(1, False)
    driver.override(STANCE, times=2)
    assert driver.firmware.level(pin) == 1
    driver.firmware.answer(1, True)
    before = driver.firmware.messages()
    driver.time_until(lambda: driver.firmware.level(pin) == 0, 0.1)
    assert driver.firmware.messages_before_low(pin) >= before + 2, "both chips had theirs"


@pytest.mark.parametrize("messages", [1, 3, 9, 10, 11, 12])
def test_a_chip_whose_set_up_broke_off_is_set_up_again(messages: int, driver: Driver) -> None:
    driver.override(STANCE, times=5)
    driver.pass_time(0.3)  # a held pose, which is not written again and again
    driver.firmware.lose_power(1)
    driver.firmware.answer_only(1, messages)
    driver.pass_time(0.6)
    assert {each.text for each in driver.all("STATUSTEXT")} == {"a PCA9685 does not answer"}
    assert driver.newest("HEARTBEAT").system_status >= mavlink_messages.EMERGENCY
    driver.firmware.answer(1, True)
    driver.pass_time(1.1)
    assert not driver.firmware.pulses_us().any(), "limp until it is commanded anew"
    driver.override(STANCE + 50, times=60)
    assert driver.firmware.pulses_us() == pytest.approx(STANCE + 50, abs=COUNT_US)
    assert driver.newest("HEARTBEAT").system_status == mavlink_messages.ACTIVE


def test_a_chip_that_lost_its_power_during_a_held_pose_releases_the_servos(driver: Driver) -> None:
    driver.override(STANCE + 50, times=5)
    driver.pass_time(0.5)
    driver.firmware.lose_power(0)
    driver.pass_time(0.6)
    assert "lost its power" in driver.newest("STATUSTEXT").text
    driver.pass_time(2.0)
    assert not driver.firmware.pulses_us().any()
    assert driver.newest("ACTUATOR_OUTPUT_STATUS").active == 0


#: Registers as other programs leave them: without auto-increment; at 60 pulses a second; inverted.
LEFT = [{0x00: 0x01}, {0x00: 0x20, 0xFE: 101}, {0x00: 0x20, 0x01: 0x14, 0xFE: 121}]


@pytest.mark.parametrize("left", LEFT)
def test_a_chip_that_another_program_left_awake_is_set_up(left: dict[int, int], driver: Driver) -> None:
    firmware = Firmware(
        STANCE, architecture="ESP32" if driver.firmware.pin_oe == PIN_OE["ESP32"] else "RP2040"
    )
    for chip in (0, 1):
        for register, value in left.items():
            firmware.registers(chip)[register] = value
    driver.firmware = firmware
    firmware.begin(driver.now_s)
    assert firmware.level(firmware.pin_oe) == 1, "what it has from before moves nothing"
    driver.override(STANCE, times=5)
    assert firmware.pulses_us() == pytest.approx(STANCE, abs=COUNT_US)
    assert [firmware.chip(chip)[0x01] for chip in (0, 1)] == [0x04, 0x04]
    assert driver.all("STATUSTEXT") == []


# The program.


def test_no_fault_is_reported_at_the_start(driver: Driver) -> None:
    driver.pass_time(1.0)
    assert driver.all("STATUSTEXT") == []
    assert driver.newest("HEARTBEAT").system_status == mavlink_messages.STANDBY


def test_the_hardware_watchdog_is_fed_at_each_pass() -> None:
    driver = Driver(architecture="RP2040")
    before = driver.firmware.fed()
    driver.pass_time(1.0)
    assert driver.firmware.fed() - before == 1000


def test_contacts_are_reported_with_all_six_switches_only() -> None:
    without = Driver(feet=(*PINS_FEET[:5], -1))
    without.pass_time(0.2)
    assert "contacts" not in {mavlink_messages.name_of(each) for each in without.all("NAMED_VALUE_INT")}


def test_ticks_missed_in_a_standstill_do_not_come_in_a_burst(driver: Driver) -> None:
    driver.now_s += 5.0
    driver.frames.clear()
    driver.pass_time(0.1)
    assert 4 <= len(driver.all("ACTUATOR_OUTPUT_STATUS")) <= 6
