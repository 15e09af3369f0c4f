"""Choose which of many datagrams a robot checks: no signature is computed for what was answered before."""

import random
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import zip_longest

from hexctl.serve.stops.datagram_receiver import Sender
from hexctl.wire.stop_datagram import DATAGRAM_BYTES, KIND_AT, MARK_BYTES, NONCE_AT, NONCE_BYTES, Kind

#: Nonces of answered datagrams that are known at least; twice as many at most.
MOST_NONCES = 1 << 14


class AnsweredNonces:
    """Nonces of datagrams that were answered. A client draws another one whenever it asks again."""

    def __init__(self) -> None:
        self._newer: set[bytes] = set()
        self._older: set[bytes] = set()

    def __contains__(self, nonce: bytes) -> bool:
        """Whether a datagram with this nonce was answered."""
        return nonce in self._newer or nonce in self._older

    def add(self, nonce: bytes) -> None:
        """Note the nonce of a datagram whose signature was right, and forget the oldest if there are many."""
        self._newer.add(nonce)
        if len(self._newer) >= MOST_NONCES:
            self._older, self._newer = self._newer, set()


class Waiting:
    """Datagrams of one kind that wait for their check, each once, by sender."""

    def __init__(self) -> None:
        self._senders: dict[bytes, Sender] = {}

    def add(self, data: bytes, sender: Sender) -> None:
        """Add a datagram; one that has come from elsewhere before keeps its first sender."""
        self._senders.setdefault(data, sender)

    def __iter__(self) -> Iterator[tuple[bytes, Sender]]:
        """The newest of each sender, then the second of each, and so on; senders in random order.

        One sender cannot keep out another, however much it sends.
        """
        by_sender: defaultdict[Sender, list[bytes]] = defaultdict(list)
        for data, sender in reversed(self._senders.items()):
            by_sender[sender].append(data)
        senders = random.sample(list(by_sender), len(by_sender))
        for row in zip_longest(*(by_sender[sender] for sender in senders)):
            yield from ((data, sender) for data, sender in zip(row, senders, strict=True) if data is not None)


def sort_datagrams(
    datagrams: Iterable[tuple[bytes, Sender]], mark: bytes, answered: AnsweredNonces
) -> tuple[Waiting, Waiting, int]:
    """Return the stops and the questions worth a check, and how many other datagrams were none of ours.

    Args:
        datagrams: with their senders, oldest first.
        mark: first bytes of ours.
        answered: datagrams with these nonces are left out.
    """
    stops, questions, foreign = Waiting(), Waiting(), 0
    for data, sender in datagrams:
        if len(data) != DATAGRAM_BYTES or data[:MARK_BYTES] != mark:
            foreign += 1
        elif data[NONCE_AT : NONCE_AT + NONCE_BYTES] in answered:
            continue
        elif data[KIND_AT] == Kind.STOP:
            stops.add(data, sender)
        elif data[KIND_AT] == Kind.ASK:
            questions.add(data, sender)
        else:
            foreign += 1
    return stops, questions, foreign
