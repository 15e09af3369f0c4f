"""Whether a computer refuses connections at an endpoint: known at once, while a session still tries."""

import socket
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from hexctl.wire.links import Endpoint

#: A robot that is there has answered by then: only after it is its port tried.
ANSWERS_WITHIN_S = 0.25

#: How long a connection may take to be refused.
CONNECT_TIMEOUT_S = 1.0


def is_refused(endpoint: Endpoint) -> bool:
    """Whether nothing listens at an endpoint; False where that cannot be known, as with quic.

    Waits for `CONNECT_TIMEOUT_S` at most, and for a computer with that name.
    """
    if endpoint.protocol == "quic":  # UDP does not report that nothing listens
        return False
    try:
        with socket.create_connection((endpoint.host, endpoint.port), timeout=CONNECT_TIMEOUT_S):
            return False
    except ConnectionRefusedError:
        return True
    except (OSError, UnicodeError):  # the second of a name that no host can have
        return False


class RefusalWatch:
    """Says once, while the block runs, that nothing listens at an endpoint; a thread of its own looks.

    Args:
        endpoint: as text.
        tell: called on the thread, with a text such as `nothing listens at tcp/127.0.0.1:7447`.
        answered: whether the robot has answered otherwise; nothing is told then.

    Raises InputError for an endpoint that is not allowed.
    """

    def __init__(
        self, endpoint: str, tell: Callable[[str], None], *, answered: Callable[[], bool] = lambda: False
    ) -> None:
        self._endpoint, self._tell, self._answered = Endpoint.parse(endpoint), tell, answered
        self._over = threading.Event()
        self._telling = threading.Lock()

    def __enter__(self) -> Self:
        """Begin to look; returns at once."""
        threading.Thread(target=self._look, name="refusal", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._telling:  # nothing is told from here on
            self._over.set()

    def _look(self) -> None:
        if self._over.wait(ANSWERS_WITHIN_S) or self._answered() or not is_refused(self._endpoint):
            return
        with self._telling:
            if not self._over.is_set() and not self._answered():
                self._tell(f"nothing listens at {self._endpoint}")
