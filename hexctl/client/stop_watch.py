"""Watches a stopped robot: reports who clears the stop, and whether the robot moves again."""

from collections.abc import Collection
from enum import Enum

from hexctl.client.datagram_stop import Sighting
from hexctl.errors import printable
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
