"""A port with a codec: messages out, frames in with their sender and the moment they came."""

import threading
import time
from dataclasses import dataclass
from typing import Any

from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.backends.mavlink.port import Address, Port


@dataclass(frozen=True, slots=True)
class Arrival:
    """A frame that came.

    Attributes:
        frame: what it says and who says that it sent it.
        sender: the address it came from, None on a stream.
        at_s: when, on time.monotonic.
    """

    frame: Frame
    sender: Address
    at_s: float


#: Addresses whose frames are numbered apart; more are only heard by somebody who floods.
MOST_ADDRESSES = 64


class MavlinkLink:
    """Sends from any thread; receives on one.

    Attributes:
        received_bytes: everything that came so far.
    """

    def __init__(self, port: Port, codec: Codec) -> None:
        self._port, self._codec = port, codec
        self._sending = threading.Lock()
        self._sequences: dict[Address, int] = {}
        self.received_bytes = 0

    @property
    def malformed(self) -> int:
        """Return how many runs of bytes so far were no frame of ours."""
        return self._codec.malformed

    @property
    def dropped(self) -> int:
        """Return how many frames so far could not be sent."""
        return self._port.dropped

    def send(self, message: Any, to: Address = None) -> None:
        """Send a message, or drop it where the port is full; raises OSError when the port has gone."""
        with self._sending:
            if len(self._sequences) > MOST_ADDRESSES:
                self._sequences.clear()
            # Each receiver counts what it lost by these numbers, so each has its own.
            sequence = self._sequences[to] = self._sequences.get(to, -1) + 1
            self._port.send(self._codec.encode(message, sequence), to)

    def receive(self, patience_s: float) -> list[Arrival]:
        """Return the frames that came, waiting for something for a while.

        Raises OSError when the port has gone.
        """
        arrivals = []
        for data, sender in self._port.receive(patience_s):
            at_s = time.monotonic()
            self.received_bytes += len(data)
            frames = self._codec.decode(data, whole=self._port.datagrams)
            arrivals += [Arrival(frame, sender, at_s) for frame in frames]
        return arrivals

    def close(self) -> None:
        """Close the port."""
        self._port.close()
