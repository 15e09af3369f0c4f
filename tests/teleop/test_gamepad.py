"""Gamepads: event files, sticks and buttons, and the button that stops."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.drive.arbiter import Arbiter, Decision, Velocity
from hexctl.errors import InputError
from hexctl.teleop.gamepad import (
    ABS_BRAKE,
    ABS_GAS,
    ABS_HAT1X,
    ABS_HAT1Y,
    ABS_RX,
    ABS_X,
    ABS_Y,
    ABS_Z,
    BTN_EAST,
    BTN_SOUTH,
    BTN_TL,
    EV_ABS,
    EV_KEY,
    EVENT,
    LOOK_S,
    Event,
    EventFiles,
    Gamepad,
    GamepadEvents,
    StopButton,
    check_gamepad,
    find_gamepads,
    find_stop_pads,
    turn_axis,
    undrivable_pads,
)


class Pipes:
    """Named pipes in place of the event files of a folder, their ends to write to, and a clock."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.now_s = folder, 0.0
        self.ends: list[int] = []

    def found(self) -> list[Path]:
        return sorted(self.folder.iterdir())

    def plug(self, name: str) -> int:
        if not (self.folder / name).exists():
            os.mkfifo(self.folder / name)
        self.ends.append(os.open(self.folder / name, os.O_RDWR))
        self.now_s += LOOK_S
        return self.ends[-1]

    def pull(self, name: str) -> None:
        """Pull out the device that was plugged in last."""
        os.close(self.ends.pop())
        (self.folder / name).unlink()


@pytest.fixture
def pipes(tmp_path: Path) -> Iterator[Pipes]:
    (tmp_path / "input").mkdir()
    pipes = Pipes(tmp_path / "input")
    yield pipes
    for end in pipes.ends:
        os.close(end)


@pytest.fixture(params=[None, 1])
def files(pipes: Pipes, request: pytest.FixtureRequest) -> Iterator[EventFiles]:
    files = EventFiles(pipes.found, most=request.param, now_s=lambda: pipes.now_s)
    yield files
    files.close()


def test_events_may_come_in_parts(pipes: Pipes, files: EventFiles) -> None:
    end = pipes.plug("event1")
    files.look()
    data = EVENT.pack(1, 2, 1, 304, 1) + EVENT.pack(1, 2, 3, 0, -5)
    came = []
    for start in range(0, len(data), 7):
        os.write(end, data[start : start + 7])
        came.append(list(files.events()))
    assert [event for some in came for event in some] == [(1, 304, 1), (3, 0, -5)]
    assert not list(files.events())


def test_further_devices_are_opened_up_to_the_most_and_looked_for_once_in_a_while(
    pipes: Pipes, files: EventFiles
) -> None:
    for name in ("event1", "event2"):
        end = pipes.plug(name)
        files.look()
        os.write(end, EVENT.pack(0, 0, 1, 304, 1))
    opened = len(files.opened)
    assert len(list(files.events())) == opened
    files.close()
    pipes.now_s += LOOK_S
    files.look()
    assert len(files.opened) == opened
    files.close()
    files.look()
    assert not files.opened, "it has just looked"


SHOULDERS, STICK_Y, STICK_X, TURN = (1, 310), (3, 1), (3, 0), (3, 3)


def event(kind_and_code: tuple[int, int], value: int) -> bytes:
    return EVENT.pack(12, 345, *kind_and_code, value)


class Pad:
    """A pad whose event file is a named pipe that the test writes."""

    def __init__(self, pipes: Pipes) -> None:
        self.pipes = pipes
        self.arbiter = Arbiter(lambda: pipes.now_s)
        self.asked: list[str] = []
        self.leaned: list[tuple[float, ...]] = []
        self.pad = Gamepad(
            self.arbiter.source("gamepad"),
            Velocity,
            self.asked.append,
            lambda *shares: self.leaned.append(shares),
            find=pipes.found,
            now_s=lambda: pipes.now_s,
        )

    def plug_in(self) -> None:
        self.writing = self.pipes.plug("event7")
        self.pad._files.look()

    def send(self, *events: bytes) -> Decision:
        for one in events:
            os.write(self.writing, one)
        self.pad.poll()
        return self.arbiter.decide()


@pytest.fixture
def pad(pipes: Pipes) -> Pad:
    return Pad(pipes)


def test_the_sticks_drive_while_a_shoulder_button_is_held(pad: Pad) -> None:
    pad.plug_in()
    assert pad.send(event(STICK_Y, -32768)) == Decision()
    assert pad.send(event(SHOULDERS, 1)).velocity == Velocity(1.0, 0.0, 0.0)
    for _ in range(50):
        pad.pipes.now_s += 0.1  # nothing moves: a stick that is held sends no events
        pad.pad.poll()
        assert pad.arbiter.decide().velocity == Velocity(1.0, 0.0, 0.0)
    assert pad.send(event(STICK_X, -32768), event(TURN, 32767)).velocity == Velocity(1.0, 1.0, -1.0)
    assert pad.send(event(SHOULDERS, 0)) == Decision(Velocity(), "gamepad")


def test_with_both_shoulder_buttons_the_sticks_move_the_body(pad: Pad) -> None:
    pad.plug_in()
    other, middle = (1, 311), event(STICK_Y, 0)
    assert pad.send(event(SHOULDERS, 1), event(STICK_Y, -32768)).velocity == Velocity(1.0)
    assert pad.send(event(other, 1)).velocity == Velocity()
    assert not pad.leaned, "the stick has to be in the middle first"
    pad.send(middle)
    pad.send(event(STICK_Y, -32768), event(TURN, 32767), event((3, 4), -32768))
    pad.send()
    assert pad.leaned == [(1.0, 0.0, 1.0, 1.0)]
    assert pad.arbiter.decide() == Decision(Velocity(), "gamepad")
    assert pad.send(event(other, 0)).velocity == Velocity(), "it walks only from the middle"
    assert pad.send(event(SHOULDERS, 0)).velocity == Velocity()
    pad.send(event(TURN, 0), event((3, 4), 0), middle, event(SHOULDERS, 1), event(other, 1))
    pad.send(event(SHOULDERS, 0), event(other, 0))
    assert pad.asked == ["hold body"]


def test_a_pad_that_is_pulled_out_is_a_release_and_may_come_back(pad: Pad) -> None:
    pad.plug_in()
    assert pad.send(event(SHOULDERS, 1), event(STICK_Y, -32768)).velocity == Velocity(1.0)
    pad.pipes.pull("event7")
    assert pad.send() == Decision(Velocity(), "gamepad")
    assert not pad.pad._files.opened
    pad.plug_in()
    assert pad.send(event(STICK_Y, -32768)).velocity == Velocity()  # it has to be pressed again
    assert pad.send(event(SHOULDERS, 1), event(STICK_Y, -32768)).velocity == Velocity(1.0)


def test_a_stick_that_is_held_while_a_stop_is_cleared_has_to_be_let_go_first(pad: Pad) -> None:
    pad.plug_in()
    full, middle = event(STICK_Y, -32768), event(STICK_Y, 0)
    assert pad.send(event(SHOULDERS, 1), full).velocity == Velocity(1, 0, 0)
    pad.arbiter.clear()
    assert pad.send() == Decision()
    assert pad.send(middle) == Decision(Velocity(), "gamepad")
    assert pad.send(full).velocity == Velocity(1, 0, 0)
    pad.arbiter.clear()
    assert pad.send(full) == Decision()
    pad.send(event(SHOULDERS, 0))
    assert pad.send(event(SHOULDERS, 1)).velocity == Velocity(1, 0, 0)


def test_lost_events_are_a_release_and_buttons_ask(pad: Pad) -> None:
    pad.plug_in()
    pad.send(event(SHOULDERS, 1), event(STICK_Y, -32768))
    assert pad.send(event((0, 3), 0)) == Decision(Velocity(), "gamepad")
    assert pad.send(event(SHOULDERS, 1)).velocity == Velocity()
    pad.send(event((1, 305), 1), event((1, 315), 1), event((3, 17), -1), event((1, 305), 0))
    assert pad.asked == ["stop", "stand", "up"]


ANY_EVENT = st.binary(min_size=EVENT.size, max_size=EVENT.size).map(lambda data: EVENT.unpack(data)[2:])


@given(st.lists(ANY_EVENT, max_size=16))
def test_whatever_events_come_shares_stay_shares(taken: list[tuple[int, int, int]]) -> None:
    events = GamepadEvents()
    for one in taken:
        events.take(*one)
    assert all(-1 <= share <= 1 for share in events.shares)


def test_a_file_that_may_not_be_read_is_refused_and_one_that_is_missing_may_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_gamepad(tmp_path / "event7")
    os.mkfifo(tmp_path / "event7")
    check_gamepad(tmp_path / "event7")
    monkeypatch.setattr(os, "access", lambda *_: False)  # whoever runs the tests may read everything
    with pytest.raises(InputError, match=r"gamepad: .*event7"):
        check_gamepad(tmp_path / "event7")


def a_device(folder: Path, event: str, name: str, keys: str, absolute: str) -> None:
    """Describe a device as the kernel does, with bitmaps of its keys and axes."""
    capabilities = folder / event / "device" / "capabilities"
    capabilities.mkdir(parents=True)
    (capabilities / "key").write_text(f"{keys}\n")
    (capabilities / "abs").write_text(f"{absolute}\n")
    (folder / event / "device" / "name").write_text(f"{name}\n")


def words(*codes: int) -> str:
    """A bitmap in sysfs."""
    bits = axes(*codes)
    parts = [bits >> 64 * part & (1 << 64) - 1 for part in range(bits.bit_length() // 64, -1, -1)]
    return " ".join(f"{part:x}" for part in parts)


def test_gamepads_are_told_from_keyboards_and_mice(tmp_path: Path) -> None:
    # As the kernel shows a pad of the driver xpad, a keyboard, and a touchpad.
    a_device(tmp_path, "event5", "pad", "7cdb000000000000 0 0 0 0", "3003f")
    a_device(tmp_path, "event0", "keys", "402000000 3803078f800d001 feffffdfffefffff fffffffffffffffe", "0")
    a_device(tmp_path, "event1", "touch", "e520 10000 0 0 0 0", "663800011000003")
    (tmp_path / "event9").mkdir()
    assert find_gamepads(Path("/dev/input"), tmp_path) == [Path("/dev/input/event5")]


@pytest.fixture
def button(pipes: Pipes) -> Iterator[StopButton]:
    button = StopButton(pipes.found, now_s=lambda: pipes.now_s)
    yield button
    button.close()


def test_any_button_of_any_gamepad_stops(pipes: Pipes, button: StopButton) -> None:
    ends = [pipes.plug(name) for name in ("event1", "event2")]
    assert not button.pressed()
    assert button.connected == 2
    for end, code in zip(ends, (BTN_SOUTH, BTN_EAST), strict=True):
        os.write(end, event((EV_KEY, code), 1))
        assert button.pressed()
        assert not button.pressed(), "it was pressed once"


def test_released_sticks_and_buttons_do_not_stop_and_a_gamepad_may_come_back(
    pipes: Pipes, button: StopButton
) -> None:
    end = pipes.plug("event1")
    for kind, code, value in ((EV_ABS, ABS_X, 30000), (EV_KEY, BTN_SOUTH, 0), (EV_KEY, BTN_SOUTH, 2)):
        assert not button.pressed()
        os.write(end, event((kind, code), value))
    assert not button.pressed()
    pipes.pull("event1")
    assert not button.pressed()
    assert button.connected == 0
    pipes.plug("event1")
    assert not button.pressed()
    assert button.connected == 1


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
        held.append(pad.enabled)
    assert held == [False, False, True, False, False]


def axes(*codes: int) -> int:
    return sum(1 << code for code in codes)


def test_the_right_stick_is_where_the_layout_has_it() -> None:
    assert turn_axis(axes(ABS_X, ABS_Y, ABS_RX, ABS_Z, 5)) == ABS_RX  # triggers on Z and RZ
    assert turn_axis(axes(ABS_X, ABS_Y, ABS_Z, 5, ABS_GAS, ABS_BRAKE)) == ABS_Z
    assert turn_axis(axes(ABS_X, ABS_Y, ABS_Z, 5)) == ABS_RX  # Z may be a trigger, which rests at its end
    assert turn_axis(0) == ABS_RX


def test_a_joystick_is_named_and_stops(tmp_path: Path) -> None:
    known, devices = tmp_path / "sys", tmp_path / "input"
    devices.mkdir()
    joystick, pad = "DragonRise Inc. Generic USB Joystick", words(BTN_SOUTH, BTN_TL)
    a_device(known, "event1", "Good Pad", pad, words(ABS_X, ABS_Y, ABS_RX))
    a_device(known, "event2", joystick, words(*range(288, 300)), words(ABS_X, ABS_Y, 17))
    a_device(known, "event3", "Half a Joy-Con", pad, words(ABS_RX))
    a_device(known, "event4", "Keyboard", words(1, 30, 31), "0")
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
