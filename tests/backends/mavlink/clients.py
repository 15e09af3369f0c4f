"""A MAVLink client for tests that says exactly what it is told to, and keeps what it hears."""

from typing import Any, Self

import numpy as np

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.types import FloatArray
from tests.backends.mavlink.boards import PATIENCE_S, MemoryPort


class Client:
    """Speaks with a board in memory, as a separate system.

    Attributes:
        heard: all frames so far, newest last.
        sequence: number of the next frame.
    """

    def __init__(self, port: MemoryPort, *, system: int = 255, key: bytes | None = None) -> None:
        self._port, self._time = port, port.time
        self._codec = Codec(system, 191, signing_key=key)
        self.heard: list[Frame] = []
        self.sequence = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def say(self, message: Any, *, sequence: int | None = None) -> None:
        """Send a message, with its own number if it has one."""
        if sequence is not None:
            self.sequence = sequence
        self._port.send(self._codec.encode(message, self.sequence), None)
        self.sequence += 1

    def hail(self, state: int = mavlink_messages.ACTIVE) -> None:
        self.say(mavlink_messages.controller_heartbeat(state))

    def drive(self, pulses: FloatArray | list[int], *, times: int = 5, to: tuple[int, int] = (1, 1)) -> None:
        """Send the same override at 50 Hz for a while."""
        for _ in range(times):
            self.say(mavlink_messages.override(np.asarray(pulses, dtype=float), *to))
            self.listen(0.02)

    def listen(self, duration_s: float) -> None:
        """Keep what comes for a while."""
        until_s = self._time.now() + duration_s
        while (left_s := until_s - self._time.now()) > 0:
            self._take(left_s)

    def drain(self) -> None:
        """Take everything that has come so far."""
        while self._take(0.0):
            pass

    def _take(self, timeout_s: float) -> bool:
        came = self._port.receive(timeout_s)
        for data, _ in came:
            self.heard += self._codec.decode(data, whole=True)
        return bool(came)

    def newest(self, kind: str) -> Any:
        """The newest message of a kind; fails when there was none."""
        return next(frame.message for frame in reversed(self.heard) if frame.kind == kind)

    def outputs(self) -> mavlink_messages.Outputs:
        """The next channels that the board reports; unread ones are discarded."""
        self.drain()
        self.heard.clear()
        self.until(lambda: any(frame.kind == "ACTUATOR_OUTPUT_STATUS" for frame in self.heard))
        return mavlink_messages.outputs_of(self.newest("ACTUATOR_OUTPUT_STATUS"))

    def until(self, condition: Any, *, hailing: bool = False) -> None:
        """Listen until something is so."""
        until_s = self._time.now() + PATIENCE_S
        while not condition():
            assert self._time.now() < until_s, [frame.kind for frame in self.heard[-20:]]
            if hailing:
                self.hail()
            self.listen(0.1 if hailing else 0.01)

    def state(self) -> int:
        """MAV_STATE of the board's next heartbeat."""
        self.drain()
        self.heard.clear()
        self.until(lambda: any(frame.kind == "HEARTBEAT" for frame in self.heard), hailing=True)
        return int(self.newest("HEARTBEAT").system_status)
