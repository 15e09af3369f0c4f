"""Clear keys of the stops that this user asked for: with them a stop can be cleared quickly."""

import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from hexctl.errors import InputError
from hexctl.files import read_secret, state_folder, write_new
from hexctl.wire.stop import CLEAR_KEY_BYTES, claim_in, claim_of, new_clear_key

#: Keys on the disk; older ones are removed.
MOST_KEYS = 64

#: Keys that this process made, by claim: it can clear its own stops without the disk.
_OWN: dict[str, str] = {}


class NewClaim:
    """Claim of a stop that this process is about to ask for: hash of a clear key, and request's name."""

    def __init__(self) -> None:
        self._key = new_clear_key()
        self.claim = claim_of(self._key)
        self._writer = threading.Thread(target=self._write, name="clear key", daemon=True)

    def keep(self) -> None:
        """Store the key for `hexctl estop --clear` of this user; never waits for the disk."""
        _OWN[self.claim] = self._key
        with suppress(RuntimeError):  # pressed twice, or the computer has no thread left
            self._writer.start()

    def wait(self, timeout_s: float) -> None:
        """Wait until the key is on the disk."""
        if self._writer.ident is not None:
            self._writer.join(timeout_s)

    def _write(self) -> None:
        path = _path_of(self.claim)
        with suppress(OSError, InputError):  # this process can clear the stop; others have to wait longer
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_new(path, self._key, "key", mode=0o600)
            kept = sorted(path.parent.glob("clear-*.key"), key=lambda one: one.lstat().st_mtime)
            for old in kept[:-MOST_KEYS]:
                old.unlink(missing_ok=True)


class StopOrder:
    """Whether a client wants its robots stopped, and under which claim: a new one after each clear.

    Under a cleared claim, anyone could clear the next stop after a second.
    """

    def __init__(self) -> None:
        self.ordered, self.pressed_s = threading.Event(), 0.0
        self._claim = NewClaim()
        self._lock = threading.Lock()

    @property
    def request(self) -> bytes:
        """Name of the stop: its claim, 8 bytes."""
        return bytes.fromhex(self._claim.claim)

    def press(self) -> None:
        """Want a stop; never waits."""
        if not self.ordered.is_set():
            self.pressed_s = time.monotonic()
        self.ordered.set()
        self._claim.keep()

    def cleared(self, request: bytes) -> None:
        """Take a new claim if that of the request was cleared."""
        with self._lock:
            if request == self.request:
                self._claim = NewClaim()
                if self.ordered.is_set():
                    self._claim.keep()

    def wait_stored(self, timeout_s: float) -> None:
        """Wait until the key that clears the stop is on the disk."""
        self._claim.wait(timeout_s)


def keys_for(claims: Iterable[object]) -> list[str]:
    """Clear keys that this user has for the claims of a stop."""
    return [key for claim in filter(None, map(claim_in, claims)) if (key := _key_for(claim)) is not None]


def forget(claims: Iterable[object]) -> None:
    """Remove the keys of a cleared stop."""
    for claim in filter(None, map(claim_in, claims)):
        _OWN.pop(claim, None)
        with suppress(OSError):
            _path_of(claim).unlink()


def _key_for(claim: str) -> str | None:
    key = _OWN.get(claim)
    with suppress(OSError, ValueError):
        key = key or read_secret(_path_of(claim), 4 * CLEAR_KEY_BYTES).decode("ascii").strip()
    return key


def _path_of(claim: str) -> Path:
    return state_folder() / f"clear-{claim}.key"
