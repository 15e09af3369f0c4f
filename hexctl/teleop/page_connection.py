"""Connections of the drive page, limited so that no client and no address holds up the others.

Parsing takes far longer than sending: one read of a flood has thousands of messages. Therefore bytes are
counted before anything is parsed, and messages as they are taken.
"""

import time
from asyncio import BaseTransport, Transport
from collections import Counter, OrderedDict
from collections.abc import Callable, Sequence
from typing import Any, cast

from websockets.asyncio.server import ServerConnection

#: Messages that a client may send, a second and at once. The page sends 25 a second.
MESSAGES_S = 100.0

#: Bytes that a client may send, a second and at once: the request, and its messages, which are short.
BYTES_S = 8_192.0

#: Connections that an address may open, a second and at once. A browser needs three for a page.
CONNECTIONS_S = 20.0

#: Addresses of which the connections are counted; the one that connected longest ago is dropped first.
MOST_ADDRESSES = 1_000


class Allowance:
    """An amount per second, of which up to one second's may be taken at once (a token bucket).

    Args:
        per_s: amount per second.
        now_s: monotonic time.
    """

    def __init__(self, per_s: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._per_s, self._now_s = per_s, now_s
        self._left, self._at_s = per_s, now_s()

    def take(self, amount: float = 1.0) -> bool:
        """Take an amount; False, and nothing is taken, if less is left."""
        now_s = self._now_s()
        self._left = min(self._per_s, self._left + self._per_s * (now_s - self._at_s))
        self._at_s = now_s
        if amount > self._left:
            return False
        self._left -= amount
        return True


class Addresses:
    """Counts the connections of each address.

    Args:
        now_s: monotonic time.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._allowances: OrderedDict[str, Allowance] = OrderedDict()

    def admit(self, address: str) -> bool:
        """Whether an address may open one more connection now."""
        allowance = self._allowances.pop(address, None) or Allowance(CONNECTIONS_S, self._now_s)
        self._allowances[address] = allowance
        if len(self._allowances) > MOST_ADDRESSES:
            self._allowances.popitem(last=False)
        return allowance.take()


class LimitedConnection(ServerConnection):
    """A connection that is closed when its client sends too much, or its address connects too often.

    It is closed without a closing handshake, during which a client could go on.

    Args:
        addresses: counts of all connections of a page.
        arguments: those of ServerConnection.

    Attributes:
        address: of the client.
        begun_at_s: when it connected, on time.monotonic.
        has_spoken: whether a message has come, as each page sends one at its start.
        closed_for_new_client: whether it was closed for a new client.
    """

    def __init__(self, *arguments: Any, addresses: Addresses, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._addresses = addresses
        self._messages, self._bytes = Allowance(MESSAGES_S), Allowance(BYTES_S)
        self._refused = False
        self.address, self.begun_at_s = "", time.monotonic()
        self.has_spoken = self.closed_for_new_client = False

    def close_for_new_client(self) -> None:
        """Close the connection for a new client."""
        self.closed_for_new_client = True
        self.transport.abort()

    def may_send(self) -> bool:
        """Whether one more message is within the limit; otherwise the connection is closed."""
        self.has_spoken = True
        allowed = self._messages.take()
        if not allowed:
            self.transport.abort()
        return allowed

    def connection_made(self, transport: BaseTransport) -> None:
        """Begin, or close the connection before anything is read from it."""
        peer = transport.get_extra_info("peername") or ("",)
        self.address = str(peer[0])
        self._refused = not self._addresses.admit(self.address)
        if self._refused:
            cast(Transport, transport).abort()
        else:
            super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        """Parse what was received, unless it is too much."""
        if self._refused:
            return
        if self._bytes.take(len(data)):
            super().data_received(data)
        else:
            self.transport.abort()

    def eof_received(self) -> None:
        """Note the end of a connection that was begun."""
        if not self._refused:
            super().eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """Note the loss of a connection that was begun."""
        if not self._refused:
            super().connection_lost(exc)


def least_needed(connections: Sequence[LimitedConnection], newcomer: str) -> LimitedConnection:
    """The connection that gives way to a new one: of the address with the most, silent ones first.

    Of those that have sent nothing it is the oldest, of the others the newest. Therefore a client that opens
    many connections takes their places from its own address, and none from a page that was there before.

    Args:
        connections: that may be closed, at least one.
        newcomer: address of the new connection.
    """
    counts = Counter([newcomer, *(one.address for one in connections)])

    def preference(one: LimitedConnection) -> tuple[float, ...]:
        age_s = -one.begun_at_s if one.has_spoken else one.begun_at_s
        return (-counts[one.address], one.has_spoken, age_s)

    return min(connections, key=preference)
