"""The layouts of pads that the kernel's gamepad specification allows, and joysticks."""

from pathlib import Path

import pytest

from hexctl.errors import InputError
from hexctl.teleop.event_file import EV_ABS, EV_KEY, Event
from hexctl.teleop.gamepad import (
    ABS_BRAKE,
    ABS_GAS,
    ABS_HAT1X,
    ABS_HAT1Y,
    ABS_RX,
    ABS_X,
    ABS_Y,
    ABS_Z,
    BTN_SOUTH,
    BTN_TL,
    GamepadEvents,
    check_gamepad,
    find_gamepads,
    find_stop_pads,
    turn_axis,
    undrivable_pads,
)


def asked(events: list[Event]) -> list[str]:
    pad = GamepadEvents()
    for event in events:
        pad.take(*event)
    return pad.pressed


@pytest.mark.parametrize("up", [544, 706])
def test_a_cross_of_buttons_asks_as_a_hat_does(up: int) -> None:
    buttons = [(EV_KEY, up, 1), (EV_KEY, up, 2), (EV_KEY, up, 0), (EV_KEY, up + 1, 1), (EV_KEY, up + 1, 0)]
    hat = [(EV_ABS, 17, -1), (EV_ABS, 17, 0), (EV_ABS, 17, 1), (EV_ABS, 17, 0)]
    assert asked(buttons) == asked(hat) == ["up", "down"]


def test_a_cross_that_reports_its_pressure_asks_once_for_each_press(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.teleop.gamepad.axis_range", lambda *_: (-127, 127))
    pad = GamepadEvents(0)  # not an event file: its axes are unknown
    for value in (-10, -70, -127, -90, 0, 30, 127, 64, 0):
        pad.take(EV_ABS, 17, value)
    assert pad.pressed == ["up", "down"]


@pytest.mark.parametrize("axis", [ABS_HAT1X, ABS_HAT1Y])
def test_a_shoulder_button_that_is_an_axis_holds(axis: int) -> None:
    pad = GamepadEvents()
    held = []
    for value in (0, 5000, 32767, 9000, 0):
        pad.take(EV_ABS, axis, value)
        held.append(pad.held)
    assert held == [False, False, True, False, False]


def axes(*codes: int) -> int:
    return sum(1 << code for code in codes)


def test_the_right_stick_is_where_the_layout_has_it() -> None:
    assert turn_axis(axes(ABS_X, ABS_Y, ABS_RX, ABS_Z, 5)) == ABS_RX  # triggers on Z and RZ
    assert turn_axis(axes(ABS_X, ABS_Y, ABS_Z, 5, ABS_GAS, ABS_BRAKE)) == ABS_Z
    assert turn_axis(axes(ABS_X, ABS_Y, ABS_Z, 5)) == ABS_RX  # Z may be a trigger, which rests at its end
    assert turn_axis(0) == ABS_RX


def a_device(folder: Path, event: str, name: str, keys: list[int], absolute: list[int]) -> None:
    def words(codes: list[int]) -> str:
        bits = axes(*codes)
        parts = [bits >> 64 * part & (1 << 64) - 1 for part in range(bits.bit_length() // 64, -1, -1)]
        return " ".join(f"{part:x}" for part in parts)

    capabilities = folder / event / "device" / "capabilities"
    capabilities.mkdir(parents=True)
    (capabilities / "key").write_text(words(keys))
    (capabilities / "abs").write_text(words(absolute))
    (folder / event / "device" / "name").write_text(f"{name}\n")


def test_a_joystick_is_named_and_stops(tmp_path: Path) -> None:
    known, devices = tmp_path / "sys", tmp_path / "input"
    devices.mkdir()
    a_device(known, "event1", "Good Pad", [BTN_SOUTH, BTN_TL], [ABS_X, ABS_Y, ABS_RX])
    a_device(known, "event2", "DragonRise Inc. Generic USB Joystick", [*range(288, 300)], [ABS_X, ABS_Y, 17])
    a_device(known, "event3", "Half a Joy-Con", [BTN_SOUTH, BTN_TL], [ABS_RX])
    a_device(known, "event4", "Keyboard", [1, 30, 31], [])
    assert find_gamepads(devices, known) == [devices / "event1"]
    assert find_stop_pads(devices, known) == [devices / f"event{number}" for number in (1, 2, 3)]
    lacking = undrivable_pads(devices, known)
    assert list(lacking) == [devices / "event2", devices / "event3"]
    assert lacking[devices / "event2"].startswith("DragonRise Inc. Generic USB Joystick is a joystick")
    assert lacking[devices / "event3"] == "Half a Joy-Con has no left stick"
    check_gamepad(devices / "event1", known)
    (tmp_path / "by-id").symlink_to(devices / "event2")
    with pytest.raises(InputError, match="DragonRise"):
        check_gamepad(tmp_path / "by-id", known)
