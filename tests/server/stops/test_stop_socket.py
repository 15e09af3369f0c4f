"""The datagram stop of a robot: who is answered, what stops, and that a flood changes nothing."""

import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hexctl.control.guard import Guard
from hexctl.server.stops import stop_socket
from hexctl.server.stops.latch import StopLatch
from hexctl.server.stops.stop_socket import MOST_NONCES, AnsweredNonces, StopSocket, by_turns, unanswered
from hexctl.waiting import comes_true
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import Link, Role
from hexctl.wire.stop import OTHERS_LOCKOUT_S
from hexctl.wire.stop_datagram import (
    DATAGRAM_BYTES,
    SECRET_FILE,
    Kind,
    StopDatagram,
    find_stop_secret,
    mark_of,
)
from tests.control.posed import connected
from tests.server.processes import free_port, repeated

OPERATOR, STRANGER = ("10.0.0.1", 1), ("10.0.0.2", 2)


def test_a_sender_of_a_thousand_does_not_keep_out_another_and_a_copy_waits_once() -> None:
    waiting = {b"mine": OPERATOR, **{number.to_bytes(2): STRANGER for number in range(1000)}}
    turns = list(by_turns(waiting))
    assert sorted(turns[:2]) == [((999).to_bytes(2), STRANGER), (b"mine", OPERATOR)]
    assert len(turns) == 1001
    asked = StopDatagram(kind=Kind.ASK, nonce=bytes(8)).packed(b"")
    found = unanswered([(asked, OPERATOR), (asked, STRANGER)], mark_of(b""), AnsweredNonces())
    assert found == {Kind.STOP: {}, Kind.ASK: {asked: OPERATOR}}


def test_many_answered_nonces_take_bounded_space() -> None:
    answered = AnsweredNonces()
    for number in range(3 * MOST_NONCES):
        answered.add(number.to_bytes(8))
    known = [number.to_bytes(8) in answered for number in range(3 * MOST_NONCES)]
    assert all(known[-MOST_NONCES:])
    assert sum(known) <= 2 * MOST_NONCES


SECRET = b"\1" * 32


class Bench:
    """A robot's datagram stop and its guard."""

    def __init__(self, link: Link | None = None) -> None:
        self.guard: Guard = connected()[0]
        self.latch = StopLatch(self.guard)
        self.link = Link(endpoint=f"tcp/127.0.0.1:{free_port()}") if link is None else link
        self.stop_socket = StopSocket(self.link, "ant", self.latch, lambda: True)
        self.sent = 0

    def ask(self, kind: Kind = Kind.ASK, secret: bytes = b"", **values: Any) -> StopDatagram:
        answer = self.stop_socket.answer(self.datagram(kind, secret, **values))
        assert answer is not None
        return StopDatagram.unpacked(answer, secret)

    def datagram(self, kind: Kind = Kind.ASK, secret: bytes = b"", **values: Any) -> bytes:
        self.sent += 1
        return StopDatagram(kind=kind, nonce=self.sent.to_bytes(8), **values).packed(secret)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_stop_by_datagram_is_asked_for_by_its_host(bench: Bench) -> None:
    epoch = bench.ask().epoch
    bench.stop_socket.answer(bench.datagram(Kind.STOP, epoch=epoch, request=b"12345678"), "10.0.0.7")
    stop = bench.latch.current()
    assert stop is not None
    assert stop.by == "a datagram from 10.0.0.7"
    again = bench.latch.stop(b"12345678".hex(), by="mia")
    assert (again.by, again.stop_id, again.since_s) == ("mia", stop.stop_id, stop.since_s)
    bench.stop_socket.answer(bench.datagram(Kind.STOP, epoch=epoch, request=b"12345678"), "10.0.0.8")
    assert bench.latch.current() == again, "its session says more"


def test_a_question_stops_nothing_and_an_answer_says_how_the_robot_is(bench: Bench) -> None:
    answer = bench.ask()
    assert (answer.kind, answer.robot, answer.stopped, answer.reason) == (Kind.STATE, "ant", False, "")
    assert answer.nonce == (1).to_bytes(8)
    assert answer.at_rest
    assert not answer.echoed
    assert bench.guard.stopped is None
    bench.guard.stop("expired")
    assert not bench.ask().stopped, "silence is no stop that stays"
    bench.guard.stop("fell")
    answer = bench.ask()
    stop = bench.latch.current()
    assert stop is not None
    assert (answer.stopped, answer.reason, answer.stop_id.hex()) == (True, "fell", stop.stop_id)
    bench.stop_socket = StopSocket(bench.link, "ant", bench.latch, lambda: True, lambda: True)
    assert bench.ask().echoed


def test_a_stop_needs_the_epoch_of_now_and_a_replay_is_worth_nothing(bench: Bench) -> None:
    guessed = bench.ask(Kind.STOP, epoch=b"x" * 16, request=b"mine    ")
    assert bench.guard.stopped is None
    assert not any(guessed.request), "it was not obeyed, and the answer has the epoch that is"
    recorded = bench.datagram(Kind.STOP, epoch=guessed.epoch, request=b"mine    ")
    answer = StopDatagram.unpacked(bench.stop_socket.answer(recorded) or b"", b"")
    assert answer.request == b"mine    "
    stop = bench.latch.current()
    assert stop is not None
    assert stop.reason == "estop"
    for _ in range(200):
        assert bench.stop_socket.answer(recorded) is not None
    assert bench.latch.current() == stop, "a replay neither renews the id nor puts off the clear"
    assert bench.latch.clear(stop.stop_id, stop.since_s + OTHERS_LOCKOUT_S) is None
    for _ in range(200):
        bench.stop_socket.answer(recorded)
    assert bench.guard.stopped is None


def test_what_is_not_signed_as_ours_gets_no_answer(bench: Bench) -> None:
    epoch = bench.ask().epoch
    state = bench.stop_socket.answer(bench.datagram()) or b""
    for data in (
        bench.datagram(Kind.STOP, SECRET, epoch=epoch),  # another secret
        state,  # an answer that is sent back
        bench.datagram()[:-1],
        bench.datagram() + b"x",
        b"",
        bytes(DATAGRAM_BYTES),
    ):
        assert bench.stop_socket.answer(data) is None
    assert bench.guard.stopped is None


@contextmanager
def opened(bench: Bench) -> Iterator[socket.socket]:
    """A client's socket while the robot listens."""
    with bench.stop_socket, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(5.0)
        client.connect(("127.0.0.1", bench.stop_socket.port))
        yield client


@pytest.mark.parametrize("flooded_with", ["garbage", "marked garbage", "a question that was heard"])
def test_a_stop_comes_through_a_flood(flooded_with: str) -> None:
    bench, chance = Bench(), random.Random(1)
    begin = mark_of(b"") if flooded_with == "marked garbage" else b""
    garbage = [begin + chance.randbytes(DATAGRAM_BYTES - len(begin)) for _ in range(100)]
    if flooded_with == "a question that was heard":
        garbage = [bench.datagram()] * 100
    with opened(bench) as client, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:

        def flood() -> None:
            for data in garbage:
                stranger.sendto(data, client.getpeername())

        client.settimeout(0.05)
        with repeated(flood, 0.0):
            for _ in range(1000):  # as a client does: again and again
                if bench.guard.stopped is not None:
                    break
                client.send(bench.datagram(Kind.STOP, epoch=bench.latch.epoch, request=b"mine    "))
                with suppress(TimeoutError):
                    client.recv(DATAGRAM_BYTES)
    assert bench.guard.stopped == "estop"


def test_a_repeated_datagram_gets_no_second_answer_and_one_that_asks_again_does(bench: Bench) -> None:
    with opened(bench) as client:
        stop: dict[str, Any] = {"kind": Kind.STOP, "epoch": bench.latch.epoch, "request": b"mine    "}
        recorded = bench.datagram(**stop)
        for data, nonce in ((recorded, 1), (bench.datagram(), 2), (bench.datagram(**stop), 3)):
            client.send(data)
            answer = StopDatagram.unpacked(client.recv(DATAGRAM_BYTES), b"")
            assert int.from_bytes(answer.nonce) == nonce
            client.send(recorded)
    assert answer.request == b"mine    ", "a client whose confirmation was lost gets another one"


def test_of_a_flood_the_stop_and_the_newest_question_are_answered_and_then_it_rests(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench, rests_s, waits, goes_on = Bench(), list[float](), threading.Event(), threading.Event()
    clock = SimpleNamespace(sleep=rests_s.append, monotonic=time.monotonic)
    monkeypatch.setattr(stop_socket, "time", clock)

    def at_rest() -> bool:
        waits.set()
        return goes_on.wait(60.0)

    bench.stop_socket = StopSocket(bench.link, "ant", bench.latch, at_rest)
    with opened(bench) as client:
        client.send(bench.datagram())
        assert waits.wait(10.0), "its thread answers"
        client.send(bench.datagram(Kind.STOP, epoch=bench.latch.epoch, request=b"mine    "))
        for _ in range(stop_socket.FLOOD):
            client.send(bench.datagram())
        goes_on.set()
        answers = [StopDatagram.unpacked(client.recv(DATAGRAM_BYTES), b"") for _ in range(3)]
        assert comes_true(lambda: bool(rests_s), 10.0)
    assert [int.from_bytes(answer.nonce) for answer in answers] == [1, 2, bench.sent]
    assert len(rests_s) == 1


def test_certificates_bring_the_secret_and_without_it_it_is_said(tmp_path: Path) -> None:
    make_certificates(tmp_path / "keys", hosts=["localhost"], days=1)
    link = Link(endpoint=f"tls/127.0.0.1:{free_port()}", credentials=tmp_path / "keys")
    secret = find_stop_secret(link, Role.CONTROLLER)
    assert secret
    bench = Bench(link)
    with opened(bench) as client:
        client.send(bench.datagram())  # signed as without certificates
        client.send(bench.datagram(Kind.ASK, secret))
        assert StopDatagram.unpacked(client.recv(2000), secret).nonce == (2).to_bytes(8)
    for path in (tmp_path / "keys").rglob(SECRET_FILE):
        path.unlink()
    with Bench(link).stop_socket as without:
        assert without.port is None
        assert "hexctl keys stop" in (without.trouble or "")


def test_a_port_that_is_taken_no_name_and_quic_leave_it_without_and_it_is_said(tmp_path: Path) -> None:
    first, second = Bench(), Bench()
    second = Bench(first.link)
    with first.stop_socket, second.stop_socket:
        assert first.stop_socket.trouble is None
        assert "UDP" in (second.stop_socket.trouble or "")
    nowhere = Link(endpoint=f"tls/robot..local:{free_port()}", credentials=tmp_path)
    (tmp_path / SECRET_FILE).write_text("00" * 32, encoding="ascii")
    (tmp_path / SECRET_FILE).chmod(0o600)
    with Bench(nowhere).stop_socket as none:
        assert "UDP" in (none.trouble or "")
    quic = Link(endpoint=f"quic/127.0.0.1:{free_port()}", credentials=tmp_path)
    with Bench(quic).stop_socket as none:
        assert "quic" in (none.trouble or "")


def test_an_error_of_any_kind_is_told_once_and_the_next_datagram_is_answered() -> None:
    bench, broken, asked = Bench(), [True], list[None]()

    def at_rest() -> bool:
        asked.append(None)
        if broken:
            raise RuntimeError("can't start new thread")
        return True

    bench.stop_socket = StopSocket(bench.link, "ant", bench.latch, at_rest)
    with opened(bench) as client:
        for _ in range(2):
            client.send(bench.datagram(Kind.STOP, epoch=bench.latch.epoch, request=b"mine    "))
        assert comes_true(lambda: len(asked) == 2, 10.0)
        assert bench.guard.stopped == "estop"
        assert comes_true(lambda: "can't start new thread" in (bench.stop_socket.trouble or ""), 10.0)
        assert "RuntimeError" in (bench.stop_socket.take_event() or "")
        assert bench.stop_socket.take_event() is None
        broken.clear()
        client.send(bench.datagram())
        assert StopDatagram.unpacked(client.recv(DATAGRAM_BYTES), b"").stopped
        assert comes_true(lambda: bench.stop_socket.trouble is None, 10.0)


@pytest.mark.parametrize("host", ["0.0.0.0", "[::]", "[::1]"])  # noqa: S104
def test_it_listens_where_the_link_does(host: str) -> None:
    bench = Bench(Link(endpoint=f"tcp/{host}:{free_port()}", insecure=True))
    with bench.stop_socket:
        assert bench.stop_socket.trouble is None
        port = bench.stop_socket.port
        family, place = (socket.AF_INET6, "::1") if host == "[::1]" else (socket.AF_INET, "127.0.0.1")
        with socket.socket(family, socket.SOCK_DGRAM) as client:
            client.settimeout(5.0)
            client.sendto(bench.datagram(), (place, port))
            assert len(client.recv(2000)) == DATAGRAM_BYTES
