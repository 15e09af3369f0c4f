"""The event log: every change once, in order, without delaying the robot."""

import threading
import time
from typing import Any

import pytest

from hexctl.backends.clock import Standstill
from hexctl.server.event_log import WAITING_LINES, EventLog
from hexctl.wire.stop import Clear, Stop

TIMEOUT_S = 10.0


def lines_of(*notes: dict[str, Any], clear: str = "clear") -> list[str]:
    """What is reported, without the time, of notes that come one after the other."""
    told: list[str] = []
    log = EventLog(told.append, clear=clear)
    for note in notes:
        log.note(**{"controller": None, "stopped": None, "posture": "idle", **note})
    log.close()
    return [line.partition(" ")[2] for line in told]


MUTE, MANY_MUTE = "mute: leg 5 femur (id 14)", "mute: servos of more than two legs"
WALKS = {"controller": "mia", "posture": "commanded"}


@pytest.mark.parametrize(
    ("notes", "beginnings"),
    [
        (
            [{}, {}, WALKS, WALKS, {"stopped": "expired", "posture": "holding"}, {"posture": "limp"}],
            ["commanded by mia", "STOPPED: expired", "holds", "no longer stopped (expired)", "sits"],
        ),
        (
            [{"controller": "mia"}, {}, {"stopped": "fault: servo 3"}],
            ["commanded by mia", "mia has left", "STOPPED: fault: servo 3"],
        ),
        (
            [{"stopped": "expired"}, {"stopped": "fault: servo 3"}],
            ["STOPPED: expired", "STOPPED: fault: servo 3, after expired"],
        ),
        ([{"doubt": text} for text in (None, "jumped", "jumped", None, "jumped")], ["jumped", "jumped"]),
        (
            [{"warnings": text} for text in ((), (MUTE,), (MUTE,), ())],
            [f"servos: {MUTE}", f"servos: no longer {MUTE}"],
        ),
        (
            [{"warnings": text} for text in ((MUTE,), (MANY_MUTE,), ())],
            [f"servos: {MUTE}", f"servos: {MANY_MUTE}", f"servos: no longer {MANY_MUTE}"],
        ),
        (
            [{"stopped": "fault: hot", "fault": "hot"}, {"stopped": "fault: hot"}, {}],
            ["STOPPED: fault: hot", "over, and still stopped (hot): clear", "no longer stopped (fault: hot)"],
        ),
    ],
)
def test_changes_are_told_once_and_in_order(notes: list[dict[str, Any]], beginnings: list[str]) -> None:
    told = lines_of(*notes)
    assert len(told) == len(beginnings)
    assert all(line.startswith(begin) for line, begin in zip(told, beginnings, strict=True))


@pytest.mark.parametrize(("ago_s", "caused"), [(0.0, True), (60.0, False)])
def test_a_stop_for_silence_after_a_standstill_names_it(ago_s: float, caused: bool) -> None:
    standstill = Standstill(1.5, time.monotonic() - ago_s)
    first, second = lines_of({"standstill": standstill, "stopped": "expired"})
    assert "stood still for 1.5 s" in first
    assert second.startswith("STOPPED: expired")
    assert ("stood still" in second) is caused


def test_who_asked_for_a_stop_and_who_cleared_it_is_told() -> None:
    def note(stop: Stop | None, cleared: Clear | None = None) -> dict[str, Any]:
        return {"stopped": None if stop is None else stop.reason, "stop": stop, "cleared": cleared}

    def stop(reason: str, by: str | None, number: int = 0) -> Stop:
        return Stop(stop_id=f"{number:016x}", reason=reason, since_s=0.0, by=by)

    first = Clear(stop=stop("estop", "mia", 2), by="ben", at_s=0.0)
    told = lines_of(
        note(None),
        note(stop("estop", "a datagram from 10.0.0.7")),
        note(stop("estop", "mia", 1)),
        note(stop("estop", "mia", 2)),
        note(None, first),
        note(stop("fell", None), first),
        note(stop("fault: hot", None), Clear(stop=stop("fell", "mia"), by="mia", at_s=1.0)),
        note(stop("estop", "ben", 3), Clear(stop=stop("estop", "ben", 2), by="mia", at_s=3.0)),
    )
    parts = [
        ("STOPPED: estop", "10.0.0.7"),
        ("still stopped", "mia"),
        ("no longer stopped (estop)", "ben"),
        ("STOPPED: fell", ""),
        ("cleared by mia (fell)", ""),
        ("STOPPED: fault: hot", ""),
        ("cleared by mia", ""),
        ("STOPPED: estop", "ben"),
    ]
    assert len(told) == len(parts)
    assert all(line.startswith(begin) and who in line for line, (begin, who) in zip(told, parts, strict=True))


def test_a_reader_who_is_held_up_holds_nothing_up_and_lines_that_were_left_out_are_counted() -> None:
    go, read, lines = threading.Event(), threading.Semaphore(0), list[str]()

    def say(line: str) -> None:
        go.wait(TIMEOUT_S)
        lines.append(line)
        read.release()

    log = EventLog(say)
    for number in range(10 * WAITING_LINES):
        log.note(controller=f"number {number}", stopped=None, posture="commanded")
    assert lines == []
    go.set()
    for _ in range(WAITING_LINES):
        assert read.acquire(timeout=TIMEOUT_S)
    assert lines[0].endswith("commanded by number 0")
    log.note(controller="mia", stopped=None, posture="commanded")
    log.close()
    assert lines[-1].endswith("lines dropped) commanded by mia")
