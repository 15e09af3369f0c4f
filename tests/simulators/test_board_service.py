"""Boards as library calls: checked when they are made; they report their counts."""

from typing import Any

import pytest

from hexctl.errors import InputError
from hexctl.robot.servos.drivers import BUS_DRIVERS, PWM_DRIVERS
from hexctl.server.service import ServiceStarted
from hexctl.simulators.board_service import BoardService


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"backend": "mavlink"}, "allowed: sim, mock"),
        ({"expiry_s": 2.0}, "got 2; allowed: 0.05 to 1 s"),
        ({"connect": "udpin:127.0.0.1:1", "pty": True}, "one or the other"),
        ({"bus": "feetech", "backend": "zenoh"}, "allowed: sim, mock"),
    ],
)
def test_what_cannot_be_a_board_is_refused_when_it_is_described(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        BoardService(**options)


def test_a_board_reports_its_counts() -> None:
    started: list[ServiceStarted] = []
    service = BoardService(backend="mock", pty=True)
    report = service.run(lambda: bool(started), on_started=started.append)
    assert started[0].place.startswith("/dev/")
    assert report["overrides"] == 0


@pytest.mark.parametrize("driver", [*BUS_DRIVERS, *PWM_DRIVERS])
def test_every_driver_has_a_simulated_bus_or_board(driver: Any) -> None:
    started: list[ServiceStarted] = []
    service = BoardService(bus=driver, backend="mock")
    report = service.run(lambda: bool(started), on_started=started.append)
    assert "/" in started[0].place
    assert report["goals"] == 0


@pytest.mark.parametrize(
    ("driver", "options", "message"),
    [
        ("pca9685", {"model": "sts3215"}, "model: got sts3215 with pca9685; allowed: without"),
        ("servo2040", {"model": "chica"}, "got chica; allowed: stock, fork"),
        ("feetech", {"fault": ("nack",)}, "fault: got 'nack'"),
    ],
)
def test_a_model_or_fault_that_there_is_not_is_refused(
    driver: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        BoardService(bus=driver, backend="mock", **options).run(lambda: True)
