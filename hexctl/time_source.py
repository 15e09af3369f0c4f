"""Where threads, clocks and timeouts get the time from."""

import threading
import time


class TimeSource:
    """The monotonic time of this computer, and waiting on it; a subclass can simulate another."""

    def now(self) -> float:
        """Time in s that never steps back; only differences mean anything."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        """Wait for a time, in s."""
        time.sleep(duration_s)

    def wait(self, event: threading.Event | threading.Condition, timeout_s: float | None = None) -> bool:
        """Wait until an event is set or a condition notified, at most for a time in s; whether it was."""
        return event.wait(timeout_s)

    def join(self, thread: threading.Thread) -> None:
        """Wait until a thread has ended, which may wait itself."""
        thread.join()


#: The time of this computer, for everything that is given no other.
WALL_TIME = TimeSource()
