"""Targets that a person types: gaits, failures and when they come."""

from collections.abc import Callable

from hexctl.gait.gait import parse_slots
from hexctl.robot.failure import failures_of, parse_failure
from tests.fuzz.target import Target


def _of_text(read: Callable[[str], object]) -> Callable[[bytes], object]:
    """A reader of bytes as the command line gives them: what is no UTF-8 is escaped."""
    return lambda data: read(data.decode("utf-8", "surrogateescape"))


def _gait(text: str) -> None:
    for failed in ((), (5,), (2, 3)):
        parse_slots(text, failed)


TARGETS = (
    Target(
        name="gait",
        read=_of_text(_gait),
        seeds=(b"tripod", b"57", b"5,1,2,4,3,6", b"1,1,1,1,1,1"),
        words=(b"demo", b"wave", b"ripple", b",", b"auto", b"best:"),
        most_bytes=100,
    ),
    Target(
        name="failure",
        read=_of_text(lambda text: (parse_failure(5, text), failures_of((1, 2), text))),
        seeds=(b"locked", b"limp:femur", b"weak:tibia:0.3", b"stuck:coxa:-20", b"unknown", b"locked,limp"),
        words=(b"missing", b"nan", b"inf", b"1e400", b":"),
        most_bytes=100,
    ),
)
