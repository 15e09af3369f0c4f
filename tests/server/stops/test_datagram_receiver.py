"""All datagrams that wait are received at a time, with their senders, with and without `recvmmsg`."""

import socket

import pytest

from hexctl.server.stops import datagram_receiver
from hexctl.server.stops.datagram_receiver import (
    MOST_CALLS,
    DatagramReceiver,
    address_of,
    bound_socket,
)
from hexctl.wire.links import Endpoint
from tests.server.processes import free_port


@pytest.mark.parametrize("at_a_time", [True, False])
@pytest.mark.parametrize("host", ["127.0.0.1", "[::1]"])
def test_datagrams_come_with_their_senders_and_cut_off_behind_the_longest(host: str, at_a_time: bool) -> None:
    endpoint = Endpoint.parse(f"tcp/{host}:{free_port()}")
    with bound_socket(endpoint) as bound, socket.socket(bound.family, socket.SOCK_DGRAM) as client:
        receiver = DatagramReceiver(bound, 160)
        if not at_a_time:
            receiver._receive = None
        assert not receiver.wait(0.0)
        assert receiver.take() == []
        client.connect(bound.getsockname())
        sent = [b"", b"x", bytes(range(160)), bytes(161), bytes(1000)]
        for data in sent:
            client.send(data)
        assert receiver.wait(10.0)
        taken = receiver.take()
        assert [data for data, _ in taken] == [data[:161] for data in sent]
        assert {address_of(sender) for _, sender in taken} == {client.getsockname()}


def test_many_datagrams_come_in_order_and_a_flood_does_not_hold_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(datagram_receiver, "MOST_PER_CALL", 8)
    with bound_socket(Endpoint.parse(f"tcp/127.0.0.1:{free_port()}")) as bound:
        receiver = DatagramReceiver(bound, 160)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            for number in range(40):
                client.sendto(bytes([number]), bound.getsockname())
        taken = [[data[0] for data, _ in receiver.take()] for _ in range(3)]
    assert taken == [list(range(8 * MOST_CALLS)), list(range(8 * MOST_CALLS, 40)), []]
