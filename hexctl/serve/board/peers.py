"""Who speaks to the board: all are answered, one commands."""

from dataclasses import dataclass, field

from hexctl.backends.mavlink.transport import Address, SequenceCount

#: Others that the board speaks to at one time.
MOST_PEERS = 8

#: A peer that was silent for this long is forgotten.
FORGET_AFTER_S = 5.0

#: Whoever commands loses the board to the next who wants it after this silence; heartbeats come every second.
FREE_AFTER_S = 2.5


@dataclass(eq=False, slots=True)
class Peer:
    """Another end.

    Attributes:
        address: where it speaks from, None on a stream.
        system: who it says it is.
        component: which part of it.
        heard_at_s: when it said something last, on time.monotonic.
        told_at_s: when it was told last that another commands.
        sequence: its lost frames.
    """

    address: Address
    system: int
    component: int
    heard_at_s: float
    told_at_s: float = float("-inf")
    sequence: SequenceCount = field(default_factory=SequenceCount)


class Peers:
    """The peers heard lately, and the one of them that commands.

    Attributes:
        commander: whoever moves the servos, or None.
        lost: frames of all peers so far that never came.
        out_of_order: frames that came too late or twice.
        crowded_out: peers so far that were forgotten because others came.
    """

    def __init__(self) -> None:
        self._known: list[Peer] = []
        self.commander: Peer | None = None
        self._lost_before = self._late_before = 0
        self.crowded_out = 0

    @property
    def lost(self) -> int:
        """Return how many frames never came."""
        return self._lost_before + sum(peer.sequence.lost for peer in self._known)

    @property
    def out_of_order(self) -> int:
        """Return how many frames came too late or twice."""
        return self._late_before + sum(peer.sequence.out_of_order for peer in self._known)

    def addresses(self) -> list[Address]:
        """Return where to send what is for all; a stream has the one address None."""
        return list(dict.fromkeys(peer.address for peer in self._known))

    def hear(self, address: Address, system: int, component: int, at_s: float) -> tuple[Peer, bool]:
        """Return who said something, and whether it is new."""
        for peer in [peer for peer in self._known if at_s - peer.heard_at_s > FORGET_AFTER_S]:
            self._drop(peer)
        for peer in self._known:
            if (peer.address, peer.system, peer.component) == (address, system, component):
                peer.heard_at_s = at_s
                return peer, False
        if len(self._known) >= MOST_PEERS:
            # The quietest goes: a flood of senders must not keep out whoever wants to command.
            others = [peer for peer in self._known if peer is not self.commander]
            self._drop(min(others, key=lambda peer: peer.heard_at_s))
            self.crowded_out += 1
        self._known.append(Peer(address, system, component, at_s))
        return self._known[-1], True

    def may_command(self, peer: Peer, at_s: float) -> bool:
        """Return whether a peer commands, or may begin to because nobody else does."""
        holder = self.commander
        return holder is None or holder is peer or at_s - holder.heard_at_s > FREE_AFTER_S

    def farewell(self, peer: Peer) -> None:
        """Forget a peer that says that it ends; the next may command at once."""
        self._drop(peer)
        if peer is self.commander:
            self.commander = None

    def _drop(self, peer: Peer) -> None:
        self._known.remove(peer)
        self._lost_before += peer.sequence.lost
        self._late_before += peer.sequence.out_of_order
