"""Stops a robot by datagram and by session at the same time, until it is at rest, and watches it then."""

import threading
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, Self

from hexctl.client.clear_keys import StopOrder
from hexctl.client.stop_connections import DatagramStop, SessionStop, Sighting
from hexctl.errors import HexctlError, RobotFaultError, argument, printable
from hexctl.wire import TIME_TO_LIVE_S
from hexctl.wire.connection_diagnosis import is_refused
from hexctl.wire.links import Endpoint, Link, Role, load_link
from hexctl.wire.stop import MAX_BY

SILENCE_S = 1.5

#: How long a report waits for the session, which knows who cleared the stop.
NAME_WAIT_S = 1.0


class State(Enum):
    """State of a robot after a stop, with its text; `{by}` is who cleared the stop."""

    STOPPED = "the robot is stopped and at rest"
    JOINTS_MOVE = "the robot is stopped, and its joints MOVE"
    CLEARED = "the stop was CLEARED{by}; the robot moves when a client commands it"
    MOVES = "the robot MOVES AGAIN; the stop was cleared{by}"
    SILENT = "the robot no longer answers; whether it is still stopped is not known"


class StopWatch:
    """Reports each change of a stopped robot once; `stop_id` is None if the robot did not report it."""

    def __init__(self, stop_id: str | None) -> None:
        self._stop_id = stop_id
        self._reported, self._changed_s = State.STOPPED, 0.0

    def change(self, seen: Collection[Sighting], at_s: float) -> str | None:
        """Line about a change since the last report, or None; `seen` has the newest sighting of each way."""
        state, by = _state_of(seen, at_s), self._clearer(seen)
        if state is self._reported:
            self._changed_s = at_s
            return None
        cleared = state in (State.CLEARED, State.MOVES)
        if cleared and not by and at_s - self._changed_s < NAME_WAIT_S:
            return None
        self._reported, self._changed_s = state, at_s
        return state.value.format(by=f" by {by}" if by else "")

    def _clearer(self, seen: Collection[Sighting]) -> str:
        cleared = (one.cleared for one in seen if one.cleared is not None)
        return next((printable(by)[:MAX_BY] for stop_id, by in cleared if stop_id == self._stop_id), "")


def _state_of(seen: Collection[Sighting], at_s: float) -> State:
    newest = max(seen, key=lambda one: one.at_s, default=None)
    if newest is None or at_s - newest.at_s > SILENCE_S:
        return State.SILENT
    if newest.stopped is None:
        return State.CLEARED if newest.at_rest else State.MOVES
    return State.STOPPED if newest.at_rest else State.JOINTS_MOVE


#: A robot has to be seen at rest for this long, with at most this pause between two answers.
RESTS_S, MOST_PAUSE_S = 0.5, 0.4

#: Maximum time to reach a robot, and then until it is at rest.
REACH_S, REST_TIMEOUT_S = 6.0, 5.0

#: After this time without an answer to datagrams, a failed session is an error.
DATAGRAM_S = 1.0

POLL_S, WATCH_S, EARLY_POLL_S = 0.01, 0.1, 0.001

#: A press without confirmation for this long is trouble; closing waits for one at most this long.
CONFIRM_S, END_S = 0.5, 2.0

#: Maximum wait until the clear key is on the disk.
KEY_WRITE_S = 1.0


OVERLOADED = (
    "If its network is overloaded, hexctl estop on its own computer still works, and a robot "
    f"commanded over that network stops by itself {TIME_TO_LIVE_S:g} s after the last command"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class StopResult:
    """A robot stopped and at rest.

    Attributes:
        stopped: `estop`, or the reason of an earlier stop.
        stop_id: id for clearing the stop; None if the robot did not report it.
        at_rest: always True.
        on_disk: whether the stop will survive a restart of the server.
        ways: `datagram` and `session` that confirmed it.
        took_s: time until the first confirmation of the stop.
        rested_s: time until it was first seen at rest, and stayed so.
        answers: of the session, with the robot's identity; empty without a session.
        echoed: whether rest is known only from constant targets, because servos do not report their angles.
    """

    stopped: str
    stop_id: str | None
    at_rest: bool
    on_disk: bool
    robot: str
    ways: tuple[str, ...]
    took_s: float
    rested_s: float
    answers: tuple[dict[str, Any], ...]
    echoed: bool = False


@dataclass(frozen=True, slots=True)
class Reach:
    """How a robot can be reached: ways are `datagram` and `session`, `trouble` is about missing ones."""

    robot: str
    ways: tuple[str, ...]
    trouble: str

    def __str__(self) -> str:
        """One line for an operator."""
        if not self.ways:
            return f"NOT REACHABLE: {self.trouble}"
        only = f" only ({self.trouble})" if self.trouble else ""
        return f"{self.robot} is reached by {' and '.join(self.ways)}{only}"


class ReadyStop:
    """A stop that connects in advance: `press` stops the robot even if its port is flooded.

        with ReadyStop(connect="tls/robot.local:7447", credentials=Path("keys")) as ready:
            ready.press()
            print(ready.wait_for_rest().stopped)

    Args:
        connect: Zenoh endpoint of the robot; None takes that of the link, or the default.
        credentials: folder of certificates.
        insecure: whether a link to another computer may lack certificates.
        link: a link, or name or path of a link file.
        again: whether to retry a session that cannot be opened.
        stays: whether to stop the robot again if the stop is cleared, until the block ends.

    The attribute `link` is the link to the robot, as resolved at creation.

    Raises InputError for an invalid endpoint or link.
    """

    def __init__(
        self,
        *,
        connect: str | None = None,
        credentials: Path | None = None,
        insecure: bool = False,
        link: Link | str | None = None,
        again: bool = True,
        stays: bool = True,
    ) -> None:
        self.link = (
            link
            if isinstance(link, Link)
            else load_link(link, connect=connect, credentials=credentials, insecure=insecure)
        )
        Endpoint.parse(self.link.endpoint)
        self._order, self._stays, self._confirmed = StopOrder(), stays, threading.Event()
        self._lock = threading.Lock()  # guards the sightings of both ways
        self._begun_s = 0.0
        self._seen: dict[str, Sighting] = {}
        self._rested: dict[str, float] = {}
        self._first_stop_s: float | None = None
        self._datagrams = DatagramStop(self.link, self._order, partial(self._see, "datagram"))
        self._session = SessionStop(self.link, self._order, partial(self._see, "session"), again=again)

    def __enter__(self) -> Self:
        """Start to connect; returns immediately."""
        self._begun_s = time.monotonic()
        self._datagrams.begin()
        self._session.begin()
        return self

    def __exit__(self, *error: object) -> None:
        """End; without `stays`, wait for the confirmation of a press."""
        if not self._stays and self._order.pressed_s:
            self._confirmed.wait(END_S)
            self._order.wait_stored(KEY_WRITE_S)
        self._session.end()
        self._datagrams.end()

    def end_datagrams(self) -> None:
        """End the datagrams of `press_by_datagram`."""
        self._datagrams.end()

    def press_by_datagram(self, wait_s: float) -> None:
        """Stop the robot before the slow import of sessions, waiting for a confirmation; then use `with`."""
        self.press()
        self._datagrams.begin()
        until_s = time.monotonic() + wait_s
        while not (self._datagrams.obeyed or self._datagrams.trouble) and time.monotonic() < until_s:
            time.sleep(EARLY_POLL_S)

    def press(self) -> None:
        """Stop the robot by all ways; thread-safe, never waits."""
        with self._lock:
            if not self._order.ordered.is_set():
                self._confirmed.clear()
            self._order.press()
        self._datagrams.wake()
        self._session.wake()

    @property
    def clear_command(self) -> str:
        """Command that clears the stop."""
        return self.link.clear_command

    @property
    def trouble(self) -> str | None:
        """Why the robot has not confirmed the last press, or None."""
        if self._confirmed.is_set() or not 0 < self._order.pressed_s < time.monotonic() - CONFIRM_S:
            return None
        why = self.reach.trouble or "it has not stopped"
        return f"the stop is not confirmed by the robot at {self.link.endpoint}: {why}"

    @property
    def reach(self) -> Reach:
        """How the robot can currently be reached."""
        now_s = time.monotonic()
        with self._lock:
            fresh = {channel: one for channel, one in self._seen.items() if now_s - one.at_s < SILENCE_S}
        trouble = []
        if "datagram" not in fresh:
            trouble.append(self._datagrams.trouble or "no answer to datagrams")
        if "session" not in fresh:
            trouble.append(str(self._session.error or "no session yet"))
        robot = next((one.robot for one in fresh.values()), "")
        return Reach(robot, tuple(sorted(fresh)), "; ".join(trouble))

    def wait_for_rest(self, *, identity_s: float = 0.0) -> StopResult:
        """Wait until the robot has been at rest for half a second.

        Args:
            identity_s: further wait for an opening session, which has the robot's identity.

        Raises InputError for invalid certificates, RobotFaultError for a robot that cannot be
        reached, does not stop, or keeps moving.
        """
        self.press()
        rests_since_s = time.monotonic()
        while True:
            with self._lock:
                rested_s = self._rested_since_s()
                result = None if rested_s is None else self._result(rested_s)
            if result is None:
                self._raise_if_late()
                rests_since_s = time.monotonic()
            elif self._session_is_over() or time.monotonic() - rests_since_s >= identity_s:
                self._order.wait_stored(KEY_WRITE_S)
                return result
            time.sleep(POLL_S)

    def _session_is_over(self) -> bool:
        return bool(self._session.answers) or self._session.ended or self._session.error is not None

    def watch(self, result: StopResult) -> Iterator[str]:
        """Yield a line for each change of a stopped robot, which is then no longer stopped again."""
        self._order.ordered.clear()
        watch = StopWatch(result.stop_id)
        while True:
            with self._lock:
                line = watch.change(self._seen.values(), time.monotonic())
            if line is not None:
                yield line
            time.sleep(WATCH_S)

    def _see(self, channel: str, sighting: Sighting) -> None:
        with self._lock:
            self._take(channel, sighting)

    def _take(self, channel: str, sighting: Sighting) -> None:
        before = self._seen.get(channel)
        self._seen[channel] = sighting
        obeyed = self._datagrams.obeyed if channel == "datagram" else self._session.obeyed
        if obeyed is None or sighting.stopped is None:
            self._rested.pop(channel, None)
            return
        if self._first_stop_s is None:
            self._first_stop_s = time.monotonic()
        if sighting.at_s >= self._order.pressed_s:
            self._confirmed.set()
            if not self._stays and (channel == "session" or not self._session.opened):
                self._order.ordered.clear()  # not while a session may still add the requester
        if not sighting.at_rest:
            self._rested.pop(channel, None)
        elif channel not in self._rested or before is None or sighting.at_s - before.at_s > MOST_PAUSE_S:
            self._rested[channel] = sighting.at_s

    def _rested_since_s(self) -> float | None:
        """One way's rest does not count if the other has since seen motion."""
        for channel, since_s in self._rested.items():
            if self._seen[channel].at_s - since_s >= RESTS_S and not self._moved_since(since_s):
                return since_s
        return None

    def _moved_since(self, at_s: float) -> bool:
        from_s = max(at_s, time.monotonic() - SILENCE_S)
        return any(
            one.at_s > from_s and (one.stopped is None or not one.at_rest) for one in self._seen.values()
        )

    def _raise_if_late(self) -> None:
        passed_s = time.monotonic() - max(self._order.pressed_s, self._begun_s)
        if self._first_stop_s is None:
            failed = self._session.ended and self._session.error is not None
            if (failed and passed_s > DATAGRAM_S) or passed_s > REACH_S:
                raise self._out_of_reach()
        elif time.monotonic() - self._first_stop_s > REST_TIMEOUT_S:
            raise RobotFaultError(
                f"the stop was sent, but the robot did not come to rest within {REST_TIMEOUT_S:g} s; go and "
                "look, with a hand at the switch of its servos' supply"
            )

    def _out_of_reach(self) -> HexctlError:
        """The error about an unreachable robot, with the other means that stop it."""
        error = self._session.error or RobotFaultError(
            f"no robot answers at {self.link.endpoint}: {self.reach.trouble}"
        )
        if not isinstance(error, RobotFaultError) or is_refused(Endpoint.parse(self.link.endpoint)):
            return error
        why = error.worded(argument)
        return RobotFaultError(f"{why}{'' if why.endswith('?') else '.'} {OVERLOADED}")

    def _result(self, rested_s: float) -> StopResult:
        stops = {channel: one for channel, one in self._seen.items() if one.stopped is not None}
        newest = max(stops.values(), key=lambda one: one.at_s)
        assert self._first_stop_s is not None  # noqa: S101  it rests because it has stopped
        return StopResult(
            stopped=newest.stopped or "",
            stop_id=newest.stop_id,
            at_rest=newest.at_rest,
            on_disk=newest.on_disk,
            robot=newest.robot,
            ways=tuple(sorted(stops)),
            took_s=self._first_stop_s - self._order.pressed_s,
            rested_s=max(0.0, rested_s - self._order.pressed_s),
            answers=tuple(self._session.answers),
            echoed=newest.echoed,
        )


def estop(
    *,
    connect: str | None = None,
    credentials: Path | None = None,
    insecure: bool = False,
    link: str | None = None,
) -> StopResult:
    """Stop a robot on the network and wait until it is at rest, whichever client commands it.

    Arguments are those of `ReadyStop`. Raises the errors of `ReadyStop.wait_for_rest`, and InputError for an
    invalid link.
    """
    with ReadyStop(
        connect=connect, credentials=credentials, insecure=insecure, link=link, again=False
    ) as ready:
        return ready.wait_for_rest()


def clear_stop(
    *,
    connect: str | None = None,
    credentials: Path | None = None,
    insecure: bool = False,
    link: str | None = None,
) -> list[dict[str, Any]]:
    """Clear the current stop of a robot on the network; it moves at its next command.

    Arguments are those of `estop`. In each robot's answer `stopped` is None or the remaining reason, `error`
    is the reason of a refusal, and `cleared` the stop it refers to.

    Raises InputError for an invalid link, and RobotFaultError if no robot answers.
    """
    from hexctl.client.remote import remote_robots

    found = load_link(link, connect=connect, credentials=credentials, insecure=insecure)
    with remote_robots(found, Role.CONTROLLER) as robots:
        return robots.clear()
