"""The latch of a robot's stop: stops get ids, are stored on the disk, and end by a clear with their id."""

import secrets
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import replace
from datetime import UTC, datetime
from threading import Lock
from typing import Any

from hexctl.control.guard import Guard
from hexctl.errors import printable
from hexctl.server.stops.stop_file import StopFile
from hexctl.wire.stop import DATAGRAM_FROM, ESTOP, MAX_BY, UNNAMED, Clear, Stop, claim_in, new_stop_id
from hexctl.wire.stop_datagram import EPOCH_BYTES

#: Number of past requests recognized when repeated.
MOST_REQUESTS = 64


class StopLatch:
    """Stops a guard and clears the stop; thread-safe.

    The guard latches the reason. The latch adds an id, so that no client clears a stop that it has not seen,
    and an epoch, which changes with each clear: what was valid in one epoch is invalid in the next. A stop in
    `file` is in force immediately.

    Attributes:
        epoch: random bytes that change with each clear.
    """

    def __init__(
        self, guard: Guard, file: StopFile | None = None, commander: Callable[[], str | None] = lambda: None
    ) -> None:
        self._guard, self._file, self._commander = guard, file, commander
        self._time = guard.clock.time
        self._lock = Lock()
        self._stop: Stop | None = None
        self.cleared: Clear | None = None
        self._requests: deque[str] = deque(maxlen=MOST_REQUESTS)
        self.epoch = secrets.token_bytes(EPOCH_BYTES)
        if file is not None and (kept := file.load()) is not None:
            guard.stop(kept.reason)
            by = None if kept.by is None else printable(kept.by)[:MAX_BY]
            self._stop = Stop(
                stop_id=kept.stop_id,
                reason=kept.reason,
                since_s=self._time.now(),
                before_start_s=max(0.0, (datetime.now(UTC) - kept.at).total_seconds()),
                by=by,
                claims=kept.claims,
            )

    def current(self) -> Stop | None:
        """The stop in force, including the guard's own."""
        with self._lock:
            return self._noticed()

    def now(self) -> tuple[Stop | None, bool]:
        """The stop in force, and whether it is on the disk."""
        stop = self.current()
        return stop, stop is not None and self._file is not None and self._file.keeps(stop)

    def status(self) -> dict[str, Any] | None:
        """The stop in force, in the form of the robot's status."""
        stop, on_disk = self.now()
        return None if stop is None else stop.to_json(self._time.now(), on_disk=on_disk)

    def close(self) -> None:
        """Wait until the last stop is on the disk, unless the disk is too slow."""
        if self._file is not None:
            self._file.close()

    def stop(self, request: str | None = None, *, by: str = UNNAMED, claim: str | None = None) -> Stop:
        """Stop the robot on request of a client.

        A stop in force gets a new id and time, because a client that asks again has seen something; a
        repeated `request` changes nothing. `claim` is the hash of the client's clear key, by default the
        request.
        """
        with self._lock:
            return self._stopped_by(request, by, claim)

    def stop_in(self, epoch: bytes, request: str, *, by: str = UNNAMED) -> bool:
        """Stop the robot as `stop` does if the epoch is current; return whether it was."""
        with self._lock:
            if epoch != self.epoch:
                return False
            self._stopped_by(request, by)
            return True

    def ensure(self, *, by: str = UNNAMED) -> Stop:
        """The stop in force, or a new one."""
        with self._lock:
            stop = self._noticed()
            return stop if stop is not None and stop.stays else self._stopped_by(None, by)

    def clear(
        self, stop_id: str | None, at_s: float, *, by: str = UNNAMED, keys: Collection[str] = ()
    ) -> str | None:
        """Let the robot move again; return None, or why not, in which case nothing has changed.

        A stop for silence (`expired`) needs no id. Without the keys of all claims a stop holds longer. `at_s`
        is by `guard.clock.time`.
        """
        with self._lock:
            stop = self._noticed()
            if stop is None:
                return None
            refusal = stop.refusal(stop_id, at_s, keys, by)
            if refusal is None:
                self._guard.clear()
                self.cleared = Clear(stop=stop, by=by, at_s=self._time.now(), proved=stop.proved_by(keys))
                self.epoch = secrets.token_bytes(EPOCH_BYTES)
                self._noticed()
            return refusal

    def _stopped_by(self, request: str | None, by: str, claim: str | None = None) -> Stop:
        self._guard.stop(ESTOP)  # first: whatever fails below, the robot has stopped
        before = self._stop
        last = self._requests[-1] if self._requests else None
        repeated = request is not None and request in self._requests
        if request is not None and not repeated:
            self._requests.append(request)
        stop = self._noticed(by)
        assert stop is not None  # noqa: S101  only `clear` ends a stop, and it waits for the lock
        if not repeated:
            now_s = self._time.now()
            renewed: dict[str, Any] = {}
            if stop is before:
                renewed = {"stop_id": new_stop_id(), "since_s": now_s, "before_start_s": 0.0, "by": by}
            if stop is not before and self.cleared is not None:
                renewed = {"repeats": self.cleared.repeats_at(now_s)}
            stop = replace(stop, commander=self._commander(), **renewed)
            stop = stop.with_claim(claim or claim_in(request))
            if stop != self._stop:
                self._stop = stop
                self._keep(stop)
        elif repeated and request == last and _says_more(by, stop.by or ""):
            stop = self._stop = replace(stop, by=by)
            self._keep(stop)
        return stop

    def _noticed(self, by: str | None = None) -> Stop | None:
        reason, before = self._guard.stopped, self._stop
        if reason is None:
            self._stop = None
        elif before is None or before.reason != reason:
            self._stop = Stop(stop_id=new_stop_id(), reason=reason, since_s=self._time.now(), by=by)
            if before is not None:  # another reason keeps the claims
                self._stop = replace(self._stop, claims=before.claims, commander=before.commander)
        if self._stop is not before:
            self._keep(self._stop)
        return self._stop

    def _keep(self, stop: Stop | None) -> None:
        if self._file is not None:
            self._file.keep(stop if stop is not None and stop.stays else None)


def _says_more(by: str, before: str) -> bool:
    """A name from a session is more specific than one from a datagram."""
    named = by != UNNAMED and not by.startswith(DATAGRAM_FROM)
    return named and before.startswith(DATAGRAM_FROM)
