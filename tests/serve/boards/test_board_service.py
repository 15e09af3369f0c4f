"""Boards as library calls: checked when they are made; they report their counts."""

import pytest

from hexctl.errors import InputError
from hexctl.robot.servos.drivers import BUS_DRIVERS, PWM_DRIVERS
from hexctl.serve.boards.board_service import BoardService, BusBoardService
from hexctl.serve.service import ServiceStarted, ServosSpec

MOCK = ServosSpec(backend="mock")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BoardService(servos=ServosSpec(backend="mavlink")), "allowed: sim, mock"),
        (lambda: BoardService(expiry_s=2.0), "got 2; allowed: 0.05 to 1 s"),
        (lambda: BoardService(port="udpin:127.0.0.1:1", pty=True), "one or the other"),
        (
            lambda: BusBoardService(driver="feetech", servos=ServosSpec(backend="zenoh")),
            "allowed: sim, mock",
        ),
    ],
)
def test_what_cannot_be_a_board_is_refused_when_it_is_described(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]


def test_a_board_reports_its_counts() -> None:
    started: list[ServiceStarted] = []
    service = BoardService(servos=MOCK, pty=True)
    report = service.run(lambda: bool(started), on_started=started.append)
    assert started[0].place.startswith("/dev/")
    assert report["overrides"] == 0


@pytest.mark.parametrize("driver", [*BUS_DRIVERS, *PWM_DRIVERS])
def test_every_driver_has_a_simulated_bus_or_board(driver: str) -> None:
    started: list[ServiceStarted] = []
    service = BusBoardService(driver=driver, servos=MOCK)
    report = service.run(lambda: bool(started), on_started=started.append)
    assert "/" in started[0].place
    assert report["goals"] == 0


@pytest.mark.parametrize(
    ("driver", "options", "message"),
    [
        ("pca9685", {"model": "sts3215"}, "model: got sts3215 with pca9685; allowed: without"),
        ("servo2040", {"model": "chica"}, "got chica; allowed: stock, fork"),
        ("feetech", {"faults": ("nack",)}, "fault: got 'nack'"),
    ],
)
def test_a_model_or_fault_that_there_is_not_is_refused(
    driver: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        BusBoardService(driver=driver, servos=MOCK, **options).run(lambda: True)  # type: ignore[arg-type]
