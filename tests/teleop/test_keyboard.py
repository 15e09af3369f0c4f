"""Keys of a terminal: speeds latch, space stands still, and a terminal that goes ends the drive."""

import os
import pty
import select
import termios
from typing import Any

import pytest

from hexctl.control.drive.arbiter import Arbiter, Decision, Velocity
from hexctl.teleop.keyboard import ASK_STATUS, ESCAPE_TICKS, Keyboard, KeyTerminal, line_of


class Typist:
    """A keyboard on a pipe, the arbiter behind it, and what it asked for."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.arbiter = Arbiter(lambda: self.now_s)
        self.asked: list[tuple[str, str]] = []
        self.shown: list[str] = []
        reading, self.writing = os.pipe()
        self.keyboard = Keyboard(
            self.arbiter.source("keyboard"),
            Velocity,
            lambda request, why: self.asked.append((request, why)),
            reading,
            self.shown.append,
            now_s=lambda: self.now_s,
        )

    def type(self, keys: str) -> Decision:
        os.write(self.writing, keys.encode())
        self.keyboard.poll()
        return self.arbiter.decide()


@pytest.fixture
def typist() -> Typist:
    return Typist()


def test_each_key_changes_the_speed_that_is_set_and_it_holds(typist: Typist) -> None:
    assert typist.type("www").velocity == Velocity(0.6, 0, 0)
    for _ in range(100):
        typist.now_s += 1.0
        typist.keyboard.poll()
        assert typist.arbiter.decide().velocity == Velocity(0.6, 0, 0)
    assert typist.type("sa").velocity == Velocity(0.4, 0.2, 0)
    assert typist.type("d\x1b[D").velocity == Velocity(0.4, 0, 0.2)
    assert typist.type("wwwwwwww").velocity.forward_m_s == 1.0


def test_an_arrow_that_comes_in_parts_is_one_key(typist: Typist) -> None:
    for part in ("\x1b[", "A"):
        decision = typist.type(part)
    assert decision.velocity == Velocity(0.2, 0, 0)
    assert typist.type("\x1bOB").velocity == Velocity()


@pytest.mark.parametrize(
    "parts",
    [["\x1b[20~"], ["\x1b[1", "0~"], ["\x1b", "[11~"], ["\x1b[1;5A"], ["\x1b[0n"], ["\x1b", "[", "0", "n"]],
)
def test_other_keys_and_answers_are_no_digits(typist: Typist, parts: list[str]) -> None:
    typist.type("ww")
    for part in parts:
        assert typist.type(part).velocity == Velocity(0.4, 0, 0)
    assert typist.asked == []


@pytest.mark.parametrize("begun", ["\x1b", "\x1b[", "\x1b[1", "\x1bO"])
def test_a_space_counts_whatever_was_begun(typist: Typist, begun: str) -> None:
    typist.type("ww")
    assert typist.type(begun + " ").velocity == Velocity()
    typist.type("ww")
    typist.type(begun)
    assert typist.type(" ").velocity == Velocity()
    assert typist.asked == []


def test_a_terminal_that_answers_no_more_has_its_speed_taken_back(typist: Typist) -> None:
    typist.type("www")
    typist.now_s += 60.0
    typist.keyboard.poll()
    assert typist.arbiter.decide().velocity == Velocity(0.6, 0, 0), "it has never answered"
    typist.type("\x1b[0n")
    for _ in range(20):
        typist.now_s += 0.4
        assert typist.type("\x1b[0n").velocity == Velocity(0.6, 0, 0)
    typist.now_s += 0.49
    typist.keyboard.poll()
    assert typist.arbiter.decide().velocity == Velocity(0.6, 0, 0)
    typist.now_s += 0.02
    typist.keyboard.poll()
    assert typist.arbiter.decide() == Decision(Velocity(), "keyboard")


def test_what_was_typed_in_the_silence_moves_nothing_and_still_stops(typist: Typist) -> None:
    typist.type("\x1b[0nw")
    typist.now_s += 10.0
    typist.type("wwg1x\x1b[0n\x1b[0n")
    assert typist.arbiter.decide().velocity == Velocity()
    assert typist.asked == [("stop", "")]
    assert typist.type("w\x1b[0n").velocity == Velocity(0.2, 0, 0)


@pytest.mark.parametrize("key", [" ", "\x1b", "x"])
def test_space_stands_still_and_lets_others_drive_after_it(typist: Typist, key: str) -> None:
    typist.type("www")
    typist.type(key)
    for _ in range(ESCAPE_TICKS):  # Esc may be the beginning of another key
        typist.keyboard.poll()
    assert typist.arbiter.decide() == Decision(Velocity(), "keyboard")
    assert (("stop", "") in typist.asked) == (key == "x")
    typist.now_s += 1.0
    typist.keyboard.poll()
    assert typist.arbiter.decide().source is None


@pytest.mark.parametrize("keys", ["ww", "xw", "0ww"])
def test_a_speed_from_before_a_stand_is_forgotten(typist: Typist, keys: str) -> None:
    typist.type(keys)
    typist.arbiter.clear()  # as `Drive.stand` does
    for _ in range(3):
        typist.keyboard.poll()
        assert typist.arbiter.decide() == Decision()
    assert typist.type("w").velocity == Velocity(0.2, 0, 0)


def test_keys_ask_for_what_they_say(typist: Typist) -> None:
    typist.type("guj10W,q")
    asked = ["gait", "up", "down", "stand", "sit", "shift forward", "twist left", "quit"]
    assert [request for request, _ in typist.asked] == asked


def test_a_terminal_that_has_gone_is_a_release_and_the_end(typist: Typist) -> None:
    typist.type("www")
    os.close(typist.writing)
    typist.keyboard.poll()
    assert typist.arbiter.decide() == Decision(Velocity(), "keyboard")
    assert typist.asked == [("quit", "the terminal is closed")]
    typist.now_s += 1.0
    typist.keyboard.poll()
    assert typist.arbiter.decide() == Decision()


STATUS: dict[str, Any] = {
    "velocity": [0.071, 0.0, -0.5], "gait": "tripod", "mode": "driving", "stopped": None,
    "source": "keyboard", "battery_v": None, "said": "", "body_pose": 6 * [0.0],
    "distance_m": 12.34, "speed_m_s": 0.071, "heading_deg": -12.4,
}  # fmt: skip


def test_an_unknown_key_is_shown_for_some_time(typist: Typist) -> None:
    typist.type("we")
    for _ in range(2):
        typist.keyboard.report(STATUS)
        typist.now_s += 2.0
    first, later = typist.shown
    assert "key 'e' does nothing" in first
    assert "does nothing" not in later
    assert "12.3 m" in later


def test_the_line_has_what_the_robot_does_in_80_columns() -> None:
    status = STATUS
    assert line_of(status).startswith("forward +0.071 m/s turn -29°/s · tripod")
    line = line_of({**status, "velocity": [0.071, 0.0, 0.0]})
    assert "12.3 m at 0.07 m/s, yaw -12°" in line
    assert len(line) < 80
    assert "12.3 m, yaw" in line_of({**status, "speed_m_s": None})
    assert line_of({**status, "velocity": [-1e-5, -0.0, -1e-4]}).startswith("forward +0.000 m/s · tripod")
    assert " · body roll -4° up +1.2 cm · " in line_of({**status, "body_pose": [-0.07, 0, 0, 0, 1e-5, 0.012]})
    said = line_of({**status, "said": "leg 3 limp", "stopped": "fell"})
    assert "leg 3 limp" in said
    assert "STOPPED: fell" in said
    assert "12.3 m" not in said


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
        assert ASK_STATUS.encode() in shown
        os.write(master, b"\x1b[0n")  # after the last tick
        assert termios.tcgetattr(slave)[6][termios.VSUSP] == b"\0"
    assert select.select([slave], [], [], 0)[0] == []
    assert termios.tcgetattr(slave) == before
