"""Keys of a terminal: speeds latch, space stands still, and a terminal that goes ends the drive."""

import os
import pty
import termios
from typing import Any

import pytest

from hexctl.control.drive.arbiter import Arbiter, Decision, Velocity
from hexctl.teleop.keyboard import Keyboard, KeyTerminal, line_of


class Typist:
    """A keyboard on a pipe, the arbiter behind it, and what it asked for."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.arbiter = Arbiter(lambda: self.now_s)
        self.asked: list[tuple[str, str]] = []
        reading, self.writing = os.pipe()
        self.lines: list[str] = []
        self.keyboard = Keyboard(
            self.arbiter.source("keyboard"),
            Velocity,
            lambda request, why: self.asked.append((request, why)),
            reading,
            self.lines.append,
        )

    def type(self, keys: str) -> Decision:
        os.write(self.writing, keys.encode())
        self.keyboard.poll()
        return self.arbiter.decide()


def test_each_key_changes_the_speed_that_is_set_and_it_holds() -> None:
    typist = Typist()
    assert typist.type("www").velocity == Velocity(0.6, 0, 0)
    for _ in range(100):
        typist.now_s += 1.0
        typist.keyboard.poll()
        assert typist.arbiter.decide().velocity == Velocity(0.6, 0, 0)
    assert typist.type("sa").velocity == Velocity(0.4, 0.2, 0)
    assert typist.type("d\x1b[D").velocity == Velocity(0.4, 0, 0.2)
    assert typist.type("wwwwwwww").velocity.forward_m_s == 1.0


def test_an_arrow_that_comes_in_parts_is_one_key() -> None:
    typist = Typist()
    for part in ("\x1b[", "A"):
        decision = typist.type(part)
    assert decision.velocity == Velocity(0.2, 0, 0)
    assert typist.type("\x1bOB").velocity == Velocity()


@pytest.mark.parametrize("key", [" ", "\x1b", "x"])
def test_space_stands_still_and_lets_others_drive_after_it(key: str) -> None:
    typist = Typist()
    typist.type("www")
    assert typist.type(key) == Decision(Velocity(), "keyboard")
    assert (("stop", "") in typist.asked) == (key == "x")
    typist.now_s += 1.0
    typist.keyboard.poll()
    assert typist.arbiter.decide().source is None


def test_keys_ask_for_what_they_say() -> None:
    typist = Typist()
    typist.type("guj10q")
    assert [request for request, _ in typist.asked] == ["gait", "up", "down", "stand", "sit", "quit"]


def test_a_terminal_that_has_gone_is_a_release_and_the_end() -> None:
    typist = Typist()
    typist.type("www")
    os.close(typist.writing)
    typist.keyboard.poll()
    assert typist.arbiter.decide() == Decision(Velocity(), "keyboard")
    assert typist.asked == [("quit", "the terminal has gone")]
    typist.now_s += 1.0
    typist.keyboard.poll()
    assert typist.arbiter.decide() == Decision()


def status(**others: Any) -> dict[str, Any]:
    usual = {
        "velocity": [0.1, 0.0, -0.5], "gait": "tripod", "mode": "driving", "stopped": None,
        "source": "keyboard", "battery_v": 7.42, "said": "",
    }  # fmt: skip
    return {**usual, **others}


def test_what_the_robot_does_is_a_line() -> None:
    assert line_of(status()) == (
        "forward +0.100 left +0.000 m/s turn -29 deg/s · tripod · driving · keyboard · 7.4 V"
    )
    assert "STOPPED: leg 3 limp (1 goes on)" in line_of(status(stopped="leg 3 limp"))


def test_keys_come_one_by_one_without_echo_and_the_terminal_is_as_before_afterwards() -> None:
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    with KeyTerminal(slave, slave) as terminal:
        os.write(master, b"w")
        assert os.read(terminal.keys, 10) == b"w"
        terminal.show("forward")
        shown = os.read(master, 100)
        assert b"forward" in shown
        assert b"w" not in shown.replace(b"forward", b"")
        assert termios.tcgetattr(slave)[6][termios.VSUSP] == b"\0"
    assert termios.tcgetattr(slave) == before
