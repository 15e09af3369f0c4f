"""The datagrams of a stop: where they go, and that what keeps them from being sent is told."""

import socket
from pathlib import Path
from typing import Any

import pytest

from hexctl.client import datagram_stop
from hexctl.client.clear_keys import StopOrder
from hexctl.client.datagram_stop import DatagramStop, Sighting
from hexctl.waiting import comes_true
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import Link
from hexctl.wire.stop import OTHERS_HOLD_S
from hexctl.wire.stop_datagram import DATAGRAM_BYTES, Kind, StopDatagram
from hexctl.wire.stop_secret import SECRET_FILE
from tests.many_files import many_open_files
from tests.server.processes import free_port
from tests.server.stops.test_stop_socket import Bench


def began(link: Link) -> DatagramStop:
    way = DatagramStop(link, StopOrder(), lambda _: None)
    way.begin()
    return way


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_name_that_no_host_can_have_is_trouble() -> None:
    way = began(Link(endpoint="tcp/robot..local:7447", insecure=True))
    try:
        assert comes_true(lambda: way.trouble is not None, 10.0)
        assert "robot..local is not known here" in (way.trouble or "")
    finally:
        way.end()


def test_a_robot_that_has_another_address_now_is_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, before, asked = Bench(), free_port(), []

    def look_up(host: str, port: int, **_given: Any) -> list[Any]:
        asked.append(host)
        place = ("127.0.0.1", before if len(asked) < 3 else port)
        return [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", place)]

    seen: list[Sighting] = []
    order = StopOrder()
    with bench.stop_socket:
        monkeypatch.setattr(datagram_stop, "LOOK_UP_AGAIN_S", 0.2)
        monkeypatch.setattr("socket.getaddrinfo", look_up)
        way = DatagramStop(bench.link, order, seen.append)
        way.begin()
        try:
            assert comes_true(lambda: bool(seen), 10.0)
            assert len(asked) >= 3
            order.press()
            way.wake()
            assert comes_true(lambda: way.obeyed == order.request, 10.0)
        finally:
            way.end()
    assert bench.guard.stopped == "estop"


def test_each_address_of_a_robot_is_asked_with_its_own_nonce(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as other:
        robots = (one, other)
        for robot in robots:
            robot.settimeout(10.0)
            robot.bind(("127.0.0.1", 0))
        found = [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", robot.getsockname()) for robot in robots]
        monkeypatch.setattr("socket.getaddrinfo", lambda *_given, **_more: found)
        way = began(Link())
        try:
            asked = [robot.recv(DATAGRAM_BYTES) for robot in robots]
        finally:
            way.end()
    assert len({StopDatagram.unpacked(data, b"").nonce for data in asked}) == 2


def test_an_error_of_any_kind_is_trouble_and_the_robot_is_asked_again() -> None:
    bench, order = Bench(), StopOrder()
    seen: list[Sighting] = []

    def see(sighting: Sighting) -> None:
        seen.append(sighting)
        if len(seen) == 1:
            raise RuntimeError("can't start new thread")

    with bench.stop_socket:
        way = DatagramStop(bench.link, order, see)
        way.begin()
        try:
            assert comes_true(lambda: bool(seen), 10.0)
            order.press()
            assert comes_true(lambda: way.obeyed == order.request, 10.0)
            assert "can't start new thread" in (way.trouble or "")
        finally:
            way.end()
    assert bench.guard.stopped == "estop"


def test_a_program_with_many_open_files_stops_a_robot() -> None:
    bench, order = Bench(), StopOrder()
    order.press()
    with many_open_files(), bench.stop_socket:
        way = DatagramStop(bench.link, order, lambda _: None)
        way.begin()
        try:
            assert comes_true(lambda: way.obeyed == order.request, 10.0)
        finally:
            way.end()


def test_a_stop_that_is_made_again_after_a_clear_is_claimed_again() -> None:
    bench, order = Bench(), StopOrder()
    order.press()
    with bench.stop_socket:
        way = DatagramStop(bench.link, order, lambda _: None)
        way.begin()
        try:
            assert comes_true(lambda: way.obeyed is not None, 10.0)
            first = bench.latch.current()
            assert first is not None
            assert bench.latch.clear(first.stop_id, first.since_s + OTHERS_HOLD_S) is None
            assert comes_true(lambda: way.obeyed not in (None, bytes.fromhex(first.claims[0])), 10.0)
            again = bench.latch.current()
        finally:
            way.end()
    assert again is not None
    assert again.claims == (order.request.hex(),)
    assert again.repeats == 1, "it holds longer"


def test_an_answer_of_before_a_press_stops_no_press_from_being_sent() -> None:
    bench, order, seen = Bench(), StopOrder(), list[Sighting]()
    way = DatagramStop(bench.link, order, seen.append)

    def exchanged() -> StopDatagram:
        asked = way._next_datagram()
        way._take(bench.stop_socket.answer(asked) or b"")
        return StopDatagram.unpacked(asked, b"")

    exchanged()
    order.press()
    assert exchanged().kind is Kind.STOP
    order.wanted.clear()
    late = bench.stop_socket.answer(way._next_datagram()) or b""
    first = bench.latch.current()
    assert first is not None
    assert bench.latch.clear(first.stop_id, first.since_s + OTHERS_HOLD_S) is None
    order.press()
    way._take(late)
    assert seen[-1].stopped == "estop"
    assert seen[-1].at_s < order.pressed_s, "it was asked for before the press"
    for _ in range(2):  # the first is of an epoch that has ended
        assert exchanged().kind is Kind.STOP
    again = bench.latch.current()
    assert again is not None
    assert again.claims == (order.request.hex(),) != first.claims
    way.end()


def test_a_folder_without_the_secret_and_quic_are_trouble(tmp_path: Path) -> None:
    make_certificates(tmp_path / "keys", hosts=["localhost"], days=1)
    for path in tmp_path.rglob(SECRET_FILE):
        path.unlink()
    for link, said in (
        (Link(endpoint="tls/localhost:7447", credentials=tmp_path / "keys"), "hexctl keys stop makes one"),
        (Link(endpoint="quic/localhost:7447"), "quic"),
    ):
        way = began(link)
        assert said in (way.trouble or "")
        way.end()
