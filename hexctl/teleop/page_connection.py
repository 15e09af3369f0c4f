"""Connections of the drive page, limited so that no client and no address delays the others.

Bytes are counted before parsing, which takes far longer than sending, and messages as they are taken.
"""

import time
from asyncio import BaseTransport, Transport
from collections import Counter, OrderedDict
from collections.abc import Callable, Sequence
from typing import Any, cast

from websockets.asyncio.server import ServerConnection

#: Messages of a client per second, and in a burst. The page sends 25 a second.
MESSAGES_S = 100.0

#: Bytes of a client per second, and in a burst: the request and short messages.
BYTES_S = 8_192.0

#: Connections of an address per second, and in a burst. A browser needs three for a page.
CONNECTIONS_S = 20.0

#: Addresses with counted connections; the least recent one is dropped first.
MOST_ADDRESSES = 1_000


class Allowance:
    """A token bucket: an amount per second, of which up to one second's may be taken in a burst."""

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
    """Counts the connections of each address."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._allowances: OrderedDict[str, Allowance] = OrderedDict()

    def admit(self, address: str) -> bool:
        """Whether an address may open one more connection."""
        allowance = self._allowances.pop(address, None) or Allowance(CONNECTIONS_S, self._now_s)
        self._allowances[address] = allowance
        if len(self._allowances) > MOST_ADDRESSES:
            self._allowances.popitem(last=False)
        return allowance.take()


class LimitedConnection(ServerConnection):
    """A connection with limits on its traffic and on the connections of its address.

    It is closed without a closing handshake, during which a client could continue to send.

    Attributes:
        has_spoken: whether a message has come; each page sends one at its start.
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
        """Count a message; beyond the limit the connection is closed."""
        self.has_spoken = True
        allowed = self._messages.take()
        if not allowed:
            self.transport.abort()
        return allowed

    def connection_made(self, transport: BaseTransport) -> None:
        """Begin, or close the connection before anything is read."""
        peer = transport.get_extra_info("peername") or ("",)
        self.address = str(peer[0])
        self._refused = not self._addresses.admit(self.address)
        if self._refused:
            cast(Transport, transport).abort()
        else:
            super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        """Parse received data within the limit."""
        if self._refused:
            return
        if self._bytes.take(len(data)):
            super().data_received(data)
        else:
            self.transport.abort()

    def eof_received(self) -> None:
        """Note the end of an open connection."""
        if not self._refused:
            super().eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """Note the loss of an open connection."""
        if not self._refused:
            super().connection_lost(exc)


def least_needed(connections: Sequence[LimitedConnection], newcomer: str) -> LimitedConnection:
    """The connection that a new one replaces: of the address with the most, silent ones first.

    Of silent ones it is the oldest, otherwise the newest: a client never replaces another's earlier page.
    """
    counts = Counter([newcomer, *(one.address for one in connections)])

    def preference(one: LimitedConnection) -> tuple[float, ...]:
        age_s = -one.begun_at_s if one.has_spoken else one.begun_at_s
        return (-counts[one.address], one.has_spoken, age_s)

    return min(connections, key=preference)
