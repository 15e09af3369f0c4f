"""The event log: every change once, in order, without delaying the robot."""

import threading
import time
from typing import Any

import pytest

from hexctl.backends.clock import Standstill
from hexctl.server.event_log import STALL_HELP, WAITING_LINES, EventLog
from hexctl.wire.stop import Clear, Stop

TIMEOUT_S = 10.0


class Reader:
    """Collects lines, and may be held up."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.go = threading.Event()
        self.read = threading.Semaphore(0)

    def say(self, line: str) -> None:
        self.go.wait(TIMEOUT_S)
        self.lines.append(line.partition(" ")[2])
        self.read.release()

    def await_lines(self, count: int) -> list[str]:
        for _ in range(count):
            assert self.read.acquire(timeout=TIMEOUT_S)
        return self.lines


def test_a_position_that_is_not_believed_is_told_once() -> None:
    reader = Reader()
    reader.go.set()
    event_log = EventLog(reader.say)
    for doubt in (None, "it jumped", "it jumped", None, "it jumped"):
        event_log.note(controller=None, stopped=None, posture="idle", doubt=doubt)
    assert reader.await_lines(2) == ["it jumped", "it jumped"]


def test_changes_are_told_once_and_in_order() -> None:
    reader = Reader()
    reader.go.set()
    event_log = EventLog(reader.say)
    for _ in range(3):
        event_log.note(controller=None, stopped=None, posture="idle")
    for _ in range(3):
        event_log.note(controller="mia", stopped=None, posture="commanded")
    event_log.note(controller=None, stopped="expired", posture="holding")
    event_log.note(controller=None, stopped=None, posture="limp")
    assert reader.await_lines(5) == [
        "commanded by mia",
        "STOPPED: expired (no command came in time), commanded by mia until then",
        "holds its pose",
        "no longer stopped (expired)",
        "sits, joints limp",
    ]


def lines_of(*notes: dict[str, Any]) -> list[str]:
    """What is reported, without the time, of notes that come one after the other."""
    told: list[str] = []
    log = EventLog(told.append)
    for note in notes:
        log.note(**{"controller": None, "stopped": None, "posture": "idle", **note})
    log.close()
    return [line[9:] for line in told]


def test_a_fault_after_a_controller_has_left_is_not_blamed_on_it() -> None:
    assert lines_of({"controller": "mia"}, {}, {"stopped": "fault: servo 3"}) == [
        "commanded by mia",
        "mia has left",
        "STOPPED: fault: servo 3",
    ]


def test_a_reason_that_comes_later_names_the_first_one() -> None:
    assert lines_of({"stopped": "expired"}, {"stopped": "fault: servo 3"}) == [
        "STOPPED: expired (no command came in time)",
        "STOPPED: fault: servo 3, after expired",
    ]


@pytest.mark.parametrize(("ago_s", "caused"), [(0.0, True), (60.0, False)])
def test_a_stop_for_silence_after_a_standstill_names_it(ago_s: float, caused: bool) -> None:
    standstill = Standstill(1.5, time.monotonic() - ago_s)
    first, second = lines_of({"standstill": standstill, "stopped": "expired"})
    assert "stood still for 1.5 s" in first
    assert STALL_HELP in first
    assert second.startswith("STOPPED: expired")
    assert ("stood still" in second) is caused


def test_a_fault_that_is_over_names_the_command_that_ends_its_stop() -> None:
    told: list[str] = []
    log = EventLog(told.append, clear="hexctl estop --clear --connect tcp/127.0.0.1:7448")
    for fault in ("hot", None):
        log.note(controller=None, stopped="fault: hot", posture="idle", fault=fault)
    log.close()
    assert told[-1].endswith("(hot): hexctl estop --clear --connect tcp/127.0.0.1:7448 lets the robot move")


def test_who_asked_for_a_stop_and_who_cleared_it_is_told() -> None:
    told: list[str] = []
    log = EventLog(told.append)

    def note(stop: Stop | None, cleared: Clear | None = None) -> None:
        log.note(
            controller=None,
            stopped=None if stop is None else stop.reason,
            posture="idle",
            stop=stop,
            cleared=cleared,
        )

    def stop(reason: str, by: str | None, number: int = 0) -> Stop:
        return Stop(stop_id=f"{number:016x}", reason=reason, since_s=0.0, by=by)

    note(None)
    note(stop("estop", "a datagram from 10.0.0.7"))
    note(stop("estop", "mia", 1))
    note(stop("estop", "mia", 2))
    first = Clear(stop=stop("estop", "mia", 2), by="ben", at_s=0.0)
    note(None, first)
    note(stop("fell", None), first)
    note(stop("fell", "mia"), first)
    note(stop("fault: hot", None), Clear(stop=stop("fell", "mia"), by="mia", at_s=1.0))
    second = Clear(stop=stop("fault: hot", None), by="mia", at_s=2.0)
    note(None, second)
    note(stop("estop", "ben", 3), Clear(stop=stop("estop", "ben", 2), by="mia", at_s=3.0))
    log.close()
    assert [line.partition(" ")[2] for line in told] == [
        "STOPPED: estop, asked for by a datagram from 10.0.0.7",
        "still stopped, asked for by mia",
        "no longer stopped (estop), cleared by ben",
        "STOPPED: fell (its body leant too far)",
        "still stopped, asked for by mia",
        "cleared by mia (fell)",
        "STOPPED: fault: hot",
        "no longer stopped (fault: hot), cleared by mia",
        "cleared by mia",
        "STOPPED: estop, asked for by ben",
    ]


def test_a_fault_that_is_over_is_told_while_its_stop_is_latched() -> None:
    told: list[str] = []
    log = EventLog(told.append)
    for stopped, fault in (("fault: it fell silent", "it fell silent"), ("fault: it fell silent", None)):
        for _ in range(2):
            log.note(controller=None, stopped=stopped, posture="idle", fault=fault)
    log.note(controller=None, stopped=None, posture="idle")
    log.close()
    assert [line[9:] for line in told] == [
        "STOPPED: fault: it fell silent",
        "over, and still stopped (it fell silent): hexctl estop --clear lets the robot move",
        "no longer stopped (fault: it fell silent)",
    ]


def told_of(*warnings: str) -> list[str]:
    """What is told, without the time, of warnings that come one after the other, an empty one for none."""
    told: list[str] = []
    log = EventLog(told.append)
    for warning in warnings:
        log.note(controller=None, stopped=None, posture="idle", warnings=(warning,) if warning else ())
    log.close()
    return [line[9:] for line in told]


def test_silent_servos_of_which_there_are_more_are_not_told_to_be_heard_again() -> None:
    assert told_of("", "mute: leg 5 femur (id 14)", "mute: servos of more than two legs", "") == [
        "servos: mute: leg 5 femur (id 14)",
        "servos: mute: servos of more than two legs",
        "servos: no longer mute: servos of more than two legs",
    ]


def test_warnings_are_told_when_they_come_and_go() -> None:
    assert told_of("", "mute: leg 5 femur (id 14)", "mute: leg 5 femur (id 14)", "") == [
        "servos: mute: leg 5 femur (id 14)",
        "servos: no longer mute: leg 5 femur (id 14)",
    ]


def test_a_reader_who_is_held_up_holds_nothing_up() -> None:
    reader = Reader()
    event_log = EventLog(reader.say)
    for number in range(10 * WAITING_LINES):
        event_log.note(controller=f"number {number}", stopped=None, posture="commanded")
    assert reader.lines == []
    reader.go.set()
    assert reader.await_lines(WAITING_LINES)[0] == "commanded by number 0"


def test_what_was_told_last_is_read_before_the_end() -> None:
    reader = Reader()
    reader.go.set()
    event_log = EventLog(reader.say)
    event_log.note(controller="mia", stopped="fell", posture="holding")
    event_log.close()
    assert reader.lines == ["commanded by mia", "STOPPED: fell (its body leant too far)", "holds its pose"]


def test_lines_that_were_left_out_are_counted() -> None:
    reader = Reader()
    event_log = EventLog(reader.say)
    for number in range(WAITING_LINES + 10):
        event_log.note(controller=f"number {number}", stopped=None, posture="commanded")
    reader.go.set()
    reader.await_lines(WAITING_LINES)
    event_log.note(controller="mia", stopped=None, posture="commanded")
    event_log.close()
    assert reader.lines[-1].endswith("lines dropped) commanded by mia")
