"""Services as library calls: checked when they are made, no output, callbacks instead."""

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hexctl.backends.bus.registers import table_of
from hexctl.errors import InputError
from hexctl.robot.configs import config_root
from hexctl.server.keeper import Keeper, KeeperSpec
from hexctl.server.service import RobotService, ServiceStarted
from hexctl.simulators.register_servos import BusServo
from tests.backends.bus.boards import a_map, bus_board
from tests.backends.pwm.boards import servo2040_board
from tests.server.processes import free_port


def local() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"backend": "zenoh"}, "sim"),
        ({"connect": "/dev/ttyACM0"}, "connect"),
        ({"sit_after_s": float("nan")}, "sit"),
        ({"seed": -1}, "seed"),
        ({"backend": "mock", "failed_leg": 5}, "failed_leg"),
        ({"backend": "mock", "world": "rough"}, "world"),
    ],
)
def test_what_cannot_be_served_is_refused_when_it_is_described(options: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        RobotService(**options)


def test_a_port_that_is_missing_is_named_as_a_server_is_given_it(tmp_path: Path) -> None:
    file = tmp_path / "jethexa.yaml"
    shipped = (config_root() / "robots" / "jethexa.yaml").read_text(encoding="utf-8")
    file.write_text(re.sub(r"\n  port: .*", "", shipped), encoding="utf-8")
    with pytest.raises(InputError, match=r"^connect"):
        RobotService(backend="lx16a", robot=str(file)).run(lambda: True)


def test_a_robot_is_served_by_a_library_call(capsys: pytest.CaptureFixture[str]) -> None:
    started: list[ServiceStarted] = []
    endpoint = local()
    RobotService(backend="mock", listen=endpoint).run(lambda: bool(started), on_started=started.append)
    assert [(each.robot, each.backend, each.place) for each in started] == [("ant", "mock", endpoint)]
    assert capsys.readouterr() == ("", "")


def test_a_board_without_a_watchdog_is_said_to_be_one_at_every_start() -> None:
    with servo2040_board() as board:
        started: list[ServiceStarted] = []
        service = RobotService(backend="servo2040", robot="ant", listen=local(), connect=board.path)
        service.run(lambda: bool(started), on_started=started.append)
    (warning,) = started[0].warnings
    assert "no watchdog" in warning


def served_on_a_bus(path: str, stop: Callable[[], bool], **callbacks: Any) -> None:
    RobotService(backend="feetech", robot="phantomx", listen=local(), connect=path).run(stop, **callbacks)


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
            servo.memory[table_of("sts3215").torque.address] = holds
        started: list[ServiceStarted] = []
        said: list[str] = []
        served_on_a_bus(board.path, lambda: bool(started), on_started=started.append, on_event=said.append)
    assert any("keep their torque" in line for line in said[-1:]) is holds
