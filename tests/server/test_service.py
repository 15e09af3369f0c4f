"""Services as library calls: no output, callbacks instead, and the log of what happens."""

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.clock import Standstill
from hexctl.errors import InputError
from hexctl.robot.configs import config_root
from hexctl.server.event_log import WAITING_LINES, EventLog
from hexctl.server.keeper import Keeper, KeeperSpec
from hexctl.server.service import RobotService, ServiceStarted
from hexctl.server.snapshot import RobotSnapshot
from hexctl.simulators.register_servos import BusServo
from hexctl.types import RobotState
from hexctl.wire.stop import Clear, Stop
from tests.backends.bus.boards import MODELS_BY_NAME, a_map, bus_board
from tests.server.bench import stopped_for
from tests.server.processes import free_port


def local() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


def test_a_port_that_is_missing_is_named_as_a_server_is_given_it(tmp_path: Path) -> None:
    file = tmp_path / "jethexa.yaml"
    shipped = (config_root() / "robots" / "jethexa.yaml").read_text(encoding="utf-8")
    file.write_text(re.sub(r"\n  port: .*", "", shipped), encoding="utf-8")
    with pytest.raises(InputError, match=r"^port"):
        RobotService(backend="lx16a", robot=str(file)).run(lambda: True)


def test_a_robot_is_served_by_a_library_call(capsys: pytest.CaptureFixture[str]) -> None:
    started: list[ServiceStarted] = []
    endpoint = local()
    RobotService(backend="mock", listen=endpoint).run(lambda: bool(started), on_started=started.append)
    assert [(each.robot, each.backend, each.place) for each in started] == [("ant", "mock", endpoint)]
    assert capsys.readouterr() == ("", "")


def served_on_a_bus(path: str, stop: Callable[[], bool], **callbacks: Any) -> None:
    RobotService(backend="feetech", robot="phantomx", listen=local(), port=path).run(stop, **callbacks)


def test_a_keeper_that_has_ended_is_told_without_making_the_robot_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keepers: list[Keeper] = []

    class NotedKeeper(Keeper):
        def __init__(self, spec: KeeperSpec) -> None:
            super().__init__(spec)
            keepers.append(self)

    monkeypatch.setattr("hexctl.server.keeper.Keeper", NotedKeeper)
    said: list[tuple[str, str]] = []
    until_s = time.monotonic() + 20.0

    def stop() -> bool:
        keepers[0]._process.kill()
        return bool(said) or time.monotonic() > until_s

    with bus_board(a_map()) as board:
        served_on_a_bus(
            board.path, stop, on_event=lambda line: said.append((threading.current_thread().name, line))
        )
    assert [thread for thread, line in said if "the keeper has ended" in line] == ["event log"]


@pytest.mark.slow
@pytest.mark.parametrize("holds", [True, False])
def test_servos_that_keep_their_torque_are_mentioned_at_the_end(holds: bool) -> None:
    with bus_board(a_map()) as board:
        for servo in board._servos:
            assert isinstance(servo, BusServo)
            servo.memory[MODELS_BY_NAME["sts3215"].table.torque.address] = holds
        started: list[ServiceStarted] = []
        said: list[str] = []
        served_on_a_bus(board.path, lambda: bool(started), on_started=started.append, on_event=said.append)
    assert any("keep their torque" in line for line in said[-1:]) is holds


TIMEOUT_S = 10.0


def snapshot(
    *, stopped: str | None = None, fault: str | None = None, warnings: tuple[str, ...] = (), **more: Any
) -> RobotSnapshot:
    """A robot that is stopped for a reason, or not."""
    state = RobotState(np.zeros(18), 0.0, True, fault=fault, warnings=warnings)
    return RobotSnapshot(**{"state": state, "stop": stopped_for(stopped), **more})


def lines_of(*notes: dict[str, Any]) -> list[str]:
    """What is reported, without the time, of notes that come one after the other."""
    told: list[str] = []
    log = EventLog(told.append, clear="clear")
    for note in notes:
        log.note(snapshot(**note))
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
        return {"stop": stop, "cleared": cleared}

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
        log.note(snapshot(controller=f"number {number}", posture="commanded"))
    assert lines == []
    go.set()
    for _ in range(WAITING_LINES):
        assert read.acquire(timeout=TIMEOUT_S)
    assert lines[0].endswith("commanded by number 0")
    log.note(snapshot(controller="mia", posture="commanded"))
    log.close()
    assert lines[-1].endswith("lines dropped) commanded by mia")
