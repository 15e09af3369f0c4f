"""What is reported of a stopped robot: each change once, with who cleared the stop."""

from typing import Any

from hexctl.client.datagram_stop import Sighting
from hexctl.client.stop_watch import NAME_WAIT_S, SILENCE_S, StopWatch

STOP_ID = "00" * 8


def seen(at_s: float, **values: Any) -> Sighting:
    """What a robot says at a time: it is stopped, and at rest."""
    known: dict[str, Any] = {"stopped": "estop", "stop_id": STOP_ID, "at_rest": True}
    return Sighting(at_s=at_s, kept=True, robot="ant", **{**known, **values})


def free(at_s: float, **values: Any) -> Sighting:
    """What a robot says that is not stopped."""
    return seen(at_s, stopped=None, stop_id=None, **values)


def test_a_stop_that_stays_is_no_news() -> None:
    watch = StopWatch(STOP_ID)
    assert all(watch.change([seen(float(at_s))], at_s + 0.1) is None for at_s in range(100))


def test_a_clear_is_reported_once_with_the_name_that_comes_later() -> None:
    watch = StopWatch(STOP_ID)
    assert watch.change([seen(0.0)], 0.1) is None
    assert watch.change([free(0.2)], 0.3) is None, "the session has not said who it was"
    named = free(0.5, cleared=(STOP_ID, "mia\x1b[2J"))
    line = watch.change([free(0.6), named], 0.6)
    assert line is not None
    assert "mia" in line
    assert "\x1b" not in line
    assert watch.change([free(0.8), named], 0.9) is None
    moving = watch.change([free(1.0, at_rest=False), named], 1.1)
    assert moving is not None
    assert "mia" in moving
    assert watch.change([seen(1.2)], 1.3) is not None, "stopped again"


def test_a_clear_is_reported_without_a_name_if_none_comes() -> None:
    watch = StopWatch(STOP_ID)
    watch.change([seen(0.0)], 0.0)
    other = (f"{1:016x}", "of another stop")
    assert watch.change([free(0.1, cleared=other)], 0.1) is None
    line = watch.change([free(NAME_WAIT_S, cleared=other)], NAME_WAIT_S)
    assert line is not None
    assert other[1] not in line


def test_a_robot_that_moves_though_it_is_stopped_and_one_that_is_silent_are_reported() -> None:
    watch = StopWatch(STOP_ID)
    assert watch.change([seen(0.0, at_rest=False)], 0.1) is not None
    assert watch.change([seen(0.0, at_rest=False)], 0.1 + SILENCE_S) is not None
    assert watch.change([seen(2.0)], 2.0) is not None
