"""The servo channels of a board: what overrides drive, leave, release and refuse."""

import numpy as np
import pytest

from hexctl.errors import CommandRefusedError
from hexctl.robot.servos.servo_map import default_servo_map
from hexctl.simulators.servo_board import Channels

ALL = [1600] * 18
RELEASE, IGNORE = [0] * 8 + [65534] * 10, [65535] * 18


def channels(*overrides: list[int]) -> Channels:
    made = Channels(default_servo_map())
    for override in overrides:
        made.take(override)
    return made


def test_nothing_is_driven_before_the_first_override() -> None:
    assert not channels().active.any()


def test_all_channels_at_once() -> None:
    made = channels(list(range(1500, 1518)))
    assert made.active.all()
    np.testing.assert_array_equal(made.pulses_us, range(1500, 1518))


def test_letting_all_go() -> None:
    made = channels(ALL, RELEASE)
    assert not made.active.any()
    np.testing.assert_array_equal(made.pulses_us, ALL)


def test_65535_leaves_every_channel_as_it_is() -> None:
    np.testing.assert_array_equal(channels(ALL, IGNORE).pulses_us, ALL)
    assert channels(ALL, IGNORE).active.all()
    assert not channels(IGNORE).active.any()


def test_an_override_of_eight_channels_leaves_the_other_ten() -> None:
    """MAVLink cuts trailing zeros off, and what was cut off was not meant."""
    made = channels(ALL, [1700] * 8 + [0] * 10)
    np.testing.assert_array_equal(made.pulses_us, [1700] * 8 + [1600] * 10)
    assert made.active.all()


def test_0_lets_one_of_the_first_eight_go_and_65534_one_of_the_rest() -> None:
    made = channels(ALL, [0, *[65535] * 16, 65534])
    assert made.active.tolist() == [False, *[True] * 16, False]


@pytest.mark.parametrize("pulse", [1, 99, 5001, 60_000, 65533])
@pytest.mark.parametrize("channel", [0, 7, 8, 17])
def test_a_pulse_that_no_servo_has_makes_the_whole_override_void(pulse: int, channel: int) -> None:
    made = channels(ALL)
    wild = [1700] * 18
    wild[channel] = pulse
    with pytest.raises(CommandRefusedError, match=r"override: got .*; allowed: pulses of 100 to 5000"):
        made.take(wild)
    np.testing.assert_array_equal(made.pulses_us, ALL)


def test_65534_is_no_pulse_on_the_first_eight() -> None:
    with pytest.raises(CommandRefusedError):
        channels([65534, *[1500] * 17])


def test_pulses_are_limited_and_that_is_counted() -> None:
    made = channels([300, 3000, *[1500] * 16])
    assert made.pulses_us[:2].tolist() == [500, 2500]
    assert made.clipped == 1


def test_only_what_leaves_no_channel_driven_is_a_release() -> None:
    assert channels(ALL).released_by(RELEASE)
    assert channels().released_by(IGNORE)
    assert not channels(ALL).released_by(IGNORE)
    assert not channels(ALL).released_by([0, *[65535] * 17])
    assert not channels().released_by(ALL)
