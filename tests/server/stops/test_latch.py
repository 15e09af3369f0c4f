"""The latch: every stop has an id, a stop that is repeated is one, and a clear ends what was valid before."""

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
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

from hexctl.control.guard import Guard
from hexctl.server.stops.latch import StopLatch
from hexctl.server.stops.stop_file import StopFile
from hexctl.server.stops.stop_socket import StopSocket
from hexctl.wire.links import Link
from hexctl.wire.stop import (
    DATAGRAM_FROM,
    LIFTED_BY_LEASE,
    LOCKOUT_S,
    MOST_CLAIMS,
    OTHERS_LOCKOUT_S,
    REPEATED_WITHIN_S,
    UNNAMED,
    Clear,
    Stop,
    claim_of,
    new_clear_key,
)
from hexctl.wire.stop_datagram import NO_SECRET, Kind, StopDatagram
from tests.control.posed import connected


def stop_file(folder: Path) -> StopFile:
    return StopFile("ant", "mock", "tcp/127.0.0.1:7447", folder=folder)


@pytest.fixture
def guard() -> Guard:
    return connected()[0]


@pytest.fixture
def latch(guard: Guard) -> StopLatch:
    return StopLatch(guard)


def now(latch: StopLatch) -> Stop:
    stop = latch.current()
    assert stop is not None
    return stop


def test_each_stop_has_an_id_of_its_own_those_of_the_guard_too(guard: Guard, latch: StopLatch) -> None:
    assert latch.current() is None
    assert latch.status() is None
    guard.stop("expired")
    ids = [now(latch).stop_id]
    guard.stop("fell")
    ids.append(now(latch).stop_id)
    assert now(latch).stop_id == ids[-1], "it is the same stop as before"
    ids.append(latch.stop().stop_id)
    assert now(latch).reason == "fell", "what was wrong first is said"
    ids.append(latch.stop("request 1").stop_id)
    assert latch.stop("request 1").stop_id == ids[-1]
    assert len(set(ids)) == 4
    assert all(len(bytes.fromhex(one)) == 8 for one in ids)


def test_a_request_that_is_repeated_does_not_put_off_the_clear(latch: StopLatch) -> None:
    stop = latch.stop("mine")
    for _ in range(100):
        latch.stop("mine")
    assert now(latch) == stop
    assert latch.clear(stop.stop_id, stop.since_s + LOCKOUT_S) is None
    assert latch.current() is None


def test_who_asked_is_replaced_by_a_better_name_alone_and_written_only_then(
    guard: Guard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = stop_file(tmp_path)
    kept: list[str | None] = []
    monkeypatch.setattr(file, "keep", lambda stop: kept.append(stop.by))
    latch = StopLatch(guard, file)
    datagram = f"{DATAGRAM_FROM}10.0.0.7"
    for by in (datagram, UNNAMED, datagram, f"{DATAGRAM_FROM}10.0.0.8"):
        assert latch.stop("mine", by=by).by == datagram
    for by in ("mia on lab-pc", datagram, "ben", UNNAMED):
        assert latch.stop("mine", by=by).by == "mia on lab-pc"
    assert kept == [datagram, "mia on lab-pc"]


def test_silence_needs_no_id_and_no_time(guard: Guard, latch: StopLatch) -> None:
    guard.stop("expired")
    assert not now(latch).stays
    assert latch.clear(None, 0.0) is None
    assert guard.stopped is None


def test_a_stop_is_there_or_made(guard: Guard, latch: StopLatch) -> None:
    guard.stop("expired")
    stop = latch.ensure()
    assert stop.reason == guard.stopped == "estop"
    assert latch.ensure() == stop


def test_the_robot_is_stopped_before_anything_that_may_fail(
    guard: Guard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = stop_file(tmp_path)

    def fail(_: Stop | None) -> None:
        raise RuntimeError("no memory")

    monkeypatch.setattr(file, "keep", fail)
    latch = StopLatch(guard, file)
    guard.stop("expired")
    with pytest.raises(RuntimeError, match="no memory"):
        latch.stop("mine")
    assert guard.stopped == "estop"


def test_a_claimed_stop_is_cleared_quickly_by_its_key_and_not_by_its_id(latch: StopLatch) -> None:
    key = new_clear_key()
    stop = latch.stop(claim_of(key))
    for keys in ((), (new_clear_key(),), stop.claims):
        assert latch.clear(stop.stop_id, stop.since_s + 60.0, keys=keys) is not None
    assert latch.clear(stop.stop_id, stop.since_s + LOCKOUT_S, keys=(key,)) is None
    assert latch.current() is None


def test_a_client_that_joins_a_claimed_stop_cannot_clear_it_with_its_own_key(latch: StopLatch) -> None:
    person, client = new_clear_key(), [new_clear_key() for _ in range(2 * MOST_CLAIMS)]
    latch.stop(claim_of(person))
    for key in client:
        stop = latch.stop(claim_of(key))
        assert latch.clear(stop.stop_id, stop.since_s + 60.0, keys=client) is not None


def test_the_client_that_was_stopped_never_clears_the_stop_without_the_key(guard: Guard) -> None:
    latch, key, ever_s = StopLatch(guard, commander=lambda: "walker"), new_clear_key(), 1e6
    latch.stop(claim_of(key), by="mia")
    latch.stop(claim_of(new_clear_key()), by="walker")  # to make it a stop of its own
    latch.stop("renewed", by="walker")
    stop = now(latch)
    for at_s in (0.0, OTHERS_LOCKOUT_S, ever_s):
        assert latch.clear(stop.stop_id, stop.since_s + at_s, by="walker") is not None
    guard.stop("fell")
    assert latch.clear(now(latch).stop_id, stop.since_s + ever_s, by="walker") is not None
    assert latch.clear(now(latch).stop_id, stop.since_s + ever_s, by="ben") is None


@pytest.mark.parametrize("claim", [None, "key"])
def test_a_client_clears_the_stop_that_it_asked_for_itself(guard: Guard, claim: str | None) -> None:
    latch, keys = StopLatch(guard, commander=lambda: "walker"), () if claim is None else (claim,)
    stop = latch.stop(None if claim is None else claim_of(claim), by="walker")
    assert latch.clear(stop.stop_id, stop.since_s + LOCKOUT_S, by="walker", keys=keys) is None


def test_a_robot_that_fails_after_a_claimed_stop_stays_claimed(guard: Guard, latch: StopLatch) -> None:
    latch.stop(claim_of(new_clear_key()))
    guard.stop("fell")
    stop = now(latch)
    assert latch.clear(stop.stop_id, stop.since_s + 60.0) is not None


def test_a_stop_that_is_repeated_after_a_clear_by_others_holds_longer(latch: StopLatch) -> None:
    for lockout_s in (OTHERS_LOCKOUT_S, 2 * OTHERS_LOCKOUT_S, 4 * OTHERS_LOCKOUT_S):
        stop = latch.stop(claim_of(new_clear_key()))
        assert latch.clear(stop.stop_id, stop.since_s + lockout_s - 1.0) is not None
        assert latch.clear(stop.stop_id, stop.since_s + lockout_s) is None


def test_the_age_of_a_stop_is_shown_over_a_restart_and_its_hold_begins_anew(
    guard: Guard, tmp_path: Path
) -> None:
    latch = StopLatch(guard, stop_file(tmp_path))
    latch.stop(by="mia")
    latch.close()
    (path,) = tmp_path.glob("*.json")
    kept = json.loads(path.read_text())
    kept["at"] = "2020-01-01T00:00:00Z"
    path.write_text(json.dumps(kept))
    again = StopLatch(connected()[0], stop_file(tmp_path))
    stop = now(again)
    shown = stop.to_json(stop.since_s, on_disk=True)
    assert shown["since_s"] > 1e8
    assert shown["others_in_s"] == LOCKOUT_S
    assert again.stop(by="ben").to_json(stop.since_s, on_disk=True)["since_s"] < 10.0


@pytest.mark.parametrize(
    ("claims", "repeats", "lockout_s"),
    [((), 0, 1.0), ((), 3, 8.0), ((), 6, 60.0), (("a",), 0, 120.0), (("a",), 3, 960.0), (("a",), 4, 960.0)],
)
def test_a_stop_holds_twice_as_long_with_each_repetition_up_to_a_bound(
    claims: tuple[str, ...], repeats: int, lockout_s: float
) -> None:
    stop = Stop(
        stop_id="0", reason="fell", since_s=5.0, before_start_s=7.0, by="mia", claims=claims, repeats=repeats
    )
    assert stop.lockout_s(proved=False) == lockout_s
    assert stop.lockout_left_s(6.0, proved=False) == lockout_s - 1.0
    told = stop.to_json(6.0, on_disk=True)
    assert (told["since_s"], told["others_in_s"]) == (8.0, lockout_s - 1.0)
    assert told["clear_in_s"] == (0.0 if claims else lockout_s - 1.0), "with the keys of its claims"
    cleared = Clear(stop=stop, by="ben", at_s=10.0)
    assert cleared.repeats_at(10.0 + REPEATED_WITHIN_S - 0.1) == repeats + 1
    assert cleared.repeats_at(10.0 + REPEATED_WITHIN_S) == 0
    assert replace(cleared, proved=True).repeats_at(10.0) == 0
    assert replace(cleared, stop=replace(stop, by=None)).repeats_at(10.0) == 0


WALKER, MIA, BEN = "walker", "mia", "ben"
CLIENTS = st.sampled_from((WALKER, MIA, BEN))
WAITS_S = st.sampled_from((0.1, LOCKOUT_S, 10.0, OTHERS_LOCKOUT_S, 2000.0))


class Promises(RuleBasedStateMachine):
    """What a stop promises, whatever clients, strangers, faults and restarts come in whatever order.

    Clients stop and clear a robot of the walker, its guard finds faults, its server is killed. The model
    keeps what each client knows; the latch, its file and its datagrams are real, and time is simulated.
    """

    latch_type = StopLatch

    def __init__(self) -> None:
        super().__init__()
        self.folder = TemporaryDirectory()
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
        self.file = stop_file(Path(self.folder.name))
        self.latch = self.latch_type(self.guard, self.file, lambda: WALKER)
        self.socket = StopSocket(Link(), "ant", self.latch, lambda: True)
        self.must_be_stopped = self.guard.stopped is not None
        self.asked_at_s = self.now_s

    def teardown(self) -> None:
        self.latch.close()
        self.folder.cleanup()

    def stop_id(self) -> str | None:
        """What the status tells every client."""
        stop = self.latch.current()
        return None if stop is None else stop.stop_id

    def note_stop(self) -> None:
        self.must_be_stopped, self.asked_at_s = True, self.now_s

    @rule(seconds=WAITS_S)
    def wait(self, seconds: float) -> None:
        self.pass_by(seconds)

    def pass_by(self, seconds: float) -> None:
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
        answer = StopDatagram.unpacked(self.socket.answer(question) or b"", NO_SECRET)
        key = new_clear_key()
        self.keys[client].add(key)
        order = self.datagram(Kind.STOP, epoch=answer.epoch, request=bytes.fromhex(claim_of(key)))
        told = StopDatagram.unpacked(self.socket.answer(order) or b"", NO_SECRET)
        assert told.stopped
        self.recorded += [question, order]
        self.note_stop()

    def datagram(self, kind: Kind, **values: Any) -> bytes:
        self.nonce += 1
        return StopDatagram(kind=kind, nonce=self.nonce.to_bytes(8), **values).packed(NO_SECRET)

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
        before = self.guard.stopped
        self.guard.stop(reason)
        self.must_be_stopped = True
        if before is None or before == LIFTED_BY_LEASE != reason:
            self.asked_at_s = self.now_s

    @rule(client=CLIENTS, knows_id=st.booleans(), shows_keys=st.booleans())
    def clear(self, client: str, knows_id: bool, shows_keys: bool) -> None:
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
        assert waited_s >= (LOCKOUT_S if proved or not stop.claims else OTHERS_LOCKOUT_S)
        stopped_by_others = bool(stop.claims) or stop.by not in (None, WALKER)
        assert proved or not (client == WALKER and stopped_by_others), "the client that was stopped moved on"

    @rule()
    def clear_together(self) -> None:
        """All who asked for the stop show their keys, in time."""
        self.pass_by(OTHERS_LOCKOUT_S)
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
