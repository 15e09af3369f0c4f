"""The time source of threads, clocks and timeouts."""

import threading
import time


class TimeSource:
    """The monotonic time of this computer, and waiting on it; a subclass can simulate another."""

    def now(self) -> float:
        """Monotonic time in s; only differences count."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        """Wait for a time, in s."""
        time.sleep(duration_s)

    def wait(self, event: threading.Event | threading.Condition, timeout_s: float | None = None) -> bool:
        """Wait until an event is set or a condition notified; return whether it was in time."""
        return event.wait(timeout_s)

    def join(self, thread: threading.Thread) -> None:
        """Wait until a thread has ended, which may wait itself."""
        thread.join()


#: The default time source.
WALL_TIME = TimeSource()
