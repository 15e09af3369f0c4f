"""What a stop promises, whatever clients, strangers, faults and restarts come in whatever order.

A model keeps what each client knows; the latch, its file and its datagrams are the real ones, and time is
simulated.
"""

import shutil
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from hexctl.server.stops.latch import StopLatch
from hexctl.server.stops.stop_file import StopFile
from hexctl.server.stops.stop_socket import StopSocket
from hexctl.wire.links import Link
from hexctl.wire.stop import HOLD_S, LIFTED_BY_LEASE, OTHERS_HOLD_S, claim_of, new_clear_key
from hexctl.wire.stop_datagram import NO_SECRET, Kind, StopDatagram
from tests.control.posed import connected

SECRET = NO_SECRET
WALKER, MIA, BEN = "walker", "mia", "ben"
CLIENTS = st.sampled_from((WALKER, MIA, BEN))
WAITS_S = st.sampled_from((0.1, HOLD_S, 10.0, OTHERS_HOLD_S, 2000.0))


class Promises(RuleBasedStateMachine):
    """Clients stop and clear a robot of the walker, its guard finds faults, its server is killed."""

    latch_type = StopLatch

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.now_s = 1000.0
        self.keys: dict[str, set[str]] = {WALKER: set(), MIA: set(), BEN: set()}
        self.recorded: list[bytes] = []
        self.nonce = 0

    @initialize()
    def start(self) -> None:
        """Start the server; what was stopped before is stopped."""
        self.guard, servos = connected()
        self.time = servos.time
        self.time.now_s = self.now_s
        self.file = StopFile("ant", "mock", "tcp/127.0.0.1:7447", folder=self.folder)
        self.latch = self.latch_type(self.guard, self.file, lambda: WALKER)
        self.socket = StopSocket(Link(), "ant", self.latch, lambda: True)
        self.must_be_stopped = self.guard.stopped is not None
        self.asked_at_s = self.now_s

    def teardown(self) -> None:
        """Remove what was kept."""
        self.latch.close()
        shutil.rmtree(self.folder)

    def stop_id(self) -> str | None:
        """What the status tells every client."""
        stop = self.latch.current()
        return None if stop is None else stop.stop_id

    def note_stop(self) -> None:
        """A stop was asked for now."""
        self.must_be_stopped, self.asked_at_s = True, self.now_s

    @rule(seconds=WAITS_S)
    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.pass_by(seconds)

    def pass_by(self, seconds: float) -> None:
        """Let time pass."""
        self.now_s += seconds
        self.time.now_s = self.now_s

    @rule(client=CLIENTS, claimed=st.booleans())
    def stop(self, client: str, claimed: bool) -> None:
        """A client stops the robot over a session, with a clear key of its own or without."""
        key = new_clear_key()
        if claimed:
            self.keys[client].add(key)
        self.latch.stop(claim_of(key) if claimed else None, by=client)
        self.note_stop()

    @rule(client=CLIENTS)
    def stop_by_datagram(self, client: str) -> None:
        """A client asks for the epoch, then stops the robot; a stranger records both."""
        question = self.datagram(Kind.ASK)
        answer = StopDatagram.unpacked(self.socket.answer(question) or b"", SECRET)
        key = new_clear_key()
        self.keys[client].add(key)
        order = self.datagram(Kind.STOP, epoch=answer.epoch, request=bytes.fromhex(claim_of(key)))
        told = StopDatagram.unpacked(self.socket.answer(order) or b"", SECRET)
        assert told.stopped
        self.recorded += [question, order]
        self.note_stop()

    def datagram(self, kind: Kind, **values: Any) -> bytes:
        """A datagram with a nonce of its own."""
        self.nonce += 1
        return StopDatagram(kind=kind, nonce=self.nonce.to_bytes(8), **values).packed(SECRET)

    @precondition(lambda self: self.recorded)
    @rule()
    def replay(self) -> None:
        """A stranger sends again all that it recorded: that neither stops a robot nor renews a stop."""
        before = self.guard.stopped, self.stop_id(), self.latch.epoch
        for data in self.recorded:
            self.socket.answer(data)
        assert (self.guard.stopped, self.stop_id(), self.latch.epoch) == before

    @rule(data=st.binary(max_size=200))
    def foreign(self, data: bytes) -> None:
        """A stranger sends anything: it has no answer."""
        assert self.socket.answer(data) is None

    @rule(reason=st.sampled_from(("fell", "fault: low battery 9.5 V", LIFTED_BY_LEASE)))
    def fault(self, reason: str) -> None:
        """The guard stops the robot by itself."""
        before = self.guard.stopped
        self.guard.stop(reason)
        self.must_be_stopped = True
        if before is None or before == LIFTED_BY_LEASE != reason:
            self.asked_at_s = self.now_s

    @rule(client=CLIENTS, knows_id=st.booleans(), shows_keys=st.booleans())
    def clear(self, client: str, knows_id: bool, shows_keys: bool) -> None:
        """A client wants the robot to move on."""
        keys = tuple(self.keys[client]) if shows_keys else ()
        self.clear_shown(client, self.stop_id() if knows_id else None, keys)

    def clear_shown(self, client: str, stop_id: str | None, keys: tuple[str, ...]) -> None:
        """A client quotes an id and shows keys; what it may not clear stays."""
        stop = self.latch.current()
        refused = self.latch.clear(stop_id, self.now_s, by=client, keys=keys)
        if stop is None or refused is not None:
            return
        self.must_be_stopped = False
        if not stop.stays:
            return
        assert stop_id is not None, "a client cleared a stop that it has not seen"
        waited_s = self.now_s - self.asked_at_s
        proved = {claim_of(key) for key in keys} >= set(stop.claims) != set()
        assert waited_s >= (HOLD_S if proved or not stop.claims else OTHERS_HOLD_S)
        stopped_by_others = bool(stop.claims) or stop.by not in (None, WALKER)
        assert proved or not (client == WALKER and stopped_by_others), "the client that was stopped moved on"

    @rule()
    def clear_together(self) -> None:
        """All who asked for the stop show their keys, in time."""
        self.pass_by(OTHERS_HOLD_S)
        keys = tuple(set().union(*self.keys.values()))
        self.clear_shown(BEN, self.stop_id(), keys)

    @rule()
    def kill(self) -> None:
        """Kill the server once its stop is on the disk, as `status` says, and start it again."""
        stop = self.latch.current()
        self.latch.close()
        self.start()
        if stop is not None and stop.stays:
            assert self.guard.stopped == stop.reason
            assert self.stop_id() == stop.stop_id
            now = self.latch.current()
            assert now is not None
            assert now.claims == stop.claims
        else:
            assert self.guard.stopped is None

    @invariant()
    def stays_stopped(self) -> None:
        """Nothing but an accepted clear lets the robot move."""
        if hasattr(self, "latch"):
            assert self.must_be_stopped == (self.guard.stopped is not None)


SETTINGS = settings(
    max_examples=60,
    stateful_step_count=30,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)


def test_a_stop_keeps_its_promises_whatever_comes() -> None:
    run_state_machine_as_test(Promises, settings=SETTINGS)


class Careless(StopLatch):
    """Clears whatever anybody wants cleared."""

    def clear(self, stop_id, at_s, *, by="", keys=()) -> None:  # type: ignore[no-untyped-def]
        self._guard.clear()


class Replayable(StopLatch):
    """Takes a stop of any epoch."""

    def stop_in(self, epoch, request, *, by="") -> bool:  # type: ignore[no-untyped-def]
        self.stop(request, by=by)
        return True


class Forgetful(StopLatch):
    """Keeps nothing on the disk."""

    def _keep(self, stop) -> None:  # type: ignore[no-untyped-def]
        pass


@pytest.mark.parametrize("broken", [Careless, Replayable, Forgetful])
def test_a_latch_that_breaks_a_promise_is_noticed(broken: type[StopLatch]) -> None:
    machine = type("Broken", (Promises,), {"latch_type": broken})
    with pytest.raises((AssertionError, ExceptionGroup)):
        run_state_machine_as_test(machine, settings=settings(SETTINGS, phases=[Phase.generate]))
