"""The newest of each kind of message that a robot says. Callbacks only store."""

import time
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Letter:
    """A message that came.

    Attributes:
        payload: as it came.
        attachment: what came beside it, or None.
        at_s: when, on time.monotonic.
    """

    payload: bytes
    attachment: bytes | None
    at_s: float


class Mailbox:
    """Keeps the newest letter of each kind; a letter that is replaced unread is no loss."""

    def __init__(self) -> None:
        self._newest: dict[str, Letter] = {}

    def put(self, kind: str, sample: Any) -> None:
        """Keep a Zenoh sample as the newest of its kind."""
        attachment = None if sample.attachment is None else bytes(sample.attachment)
        self._newest[kind] = Letter(bytes(sample.payload), attachment, time.monotonic())

    def clear(self) -> None:
        """Throw everything away."""
        self._newest.clear()

    def newest(self, kind: str) -> Letter | None:
        """Return the newest letter of a kind, or None before the first."""
        return self._newest.get(kind)
