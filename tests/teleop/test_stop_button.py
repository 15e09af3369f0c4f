"""Any button of any gamepad stops, and nothing else of a gamepad does."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexctl.teleop.event_file import EV_ABS, EV_KEY, EVENT
from hexctl.teleop.gamepad import ABS_X, BTN_EAST, BTN_SOUTH
from hexctl.teleop.stop_button import StopButton


class Pads:
    """Event files of gamepads that a test writes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.now_s = 0.0
        self.button = StopButton(lambda: sorted(folder.iterdir()), now_s=lambda: self.now_s)

    def plug(self, name: str) -> int:
        """Plug a gamepad in; its end to write to."""
        os.mkfifo(self.folder / name)
        self.now_s += 2.0
        reader = os.open(self.folder / name, os.O_RDONLY | os.O_NONBLOCK)
        writer = os.open(self.folder / name, os.O_WRONLY)
        self.button.pressed()
        os.close(reader)
        return writer


@pytest.fixture
def pads(tmp_path: Path) -> Iterator[Pads]:
    pads = Pads(tmp_path)
    yield pads
    pads.button.close()


def event(kind: int, code: int, value: int) -> bytes:
    return EVENT.pack(0, 0, kind, code, value)


def test_any_button_of_any_gamepad_stops(pads: Pads) -> None:
    first, second = pads.plug("event1"), pads.plug("event2")
    assert pads.button.connected == 2
    assert not pads.button.pressed()
    for writer, code in ((first, BTN_SOUTH), (second, BTN_EAST)):
        os.write(writer, event(EV_KEY, code, 1))
        assert pads.button.pressed()
        assert not pads.button.pressed(), "it was pressed once"
        os.close(writer)


def test_sticks_and_buttons_that_are_let_go_of_do_not(pads: Pads) -> None:
    writer = pads.plug("event1")
    os.write(writer, event(EV_ABS, ABS_X, 30000) + event(EV_KEY, BTN_SOUTH, 0) + event(EV_KEY, BTN_SOUTH, 2))
    assert not pads.button.pressed()
    os.close(writer)


def test_a_gamepad_that_is_pulled_out_is_let_go_of(pads: Pads) -> None:
    os.close(pads.plug("event1"))
    assert not pads.button.pressed()
    assert pads.button.connected == 0
