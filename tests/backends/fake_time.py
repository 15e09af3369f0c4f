"""Simulated time for tests: it advances only by `sleep` and `work`."""

from hexctl.backends.clock import PERIOD_S, WallClock


class FakeTime:
    """A monotonic clock with its sleep.

    Attributes:
        now_s: what the clock shows.
        sleeps: how long each sleep was asked to be.
        early_share: the share of a sleep that really passes before it returns.
        stopped_s: for how long the program is stopped in its next sleep.
    """

    def __init__(self, now_s: float = 1000.0, early_share: float = 1.0) -> None:
        self.now_s = now_s
        self.early_share = early_share
        self.stopped_s = 0.0
        self.sleeps: list[float] = []

    def monotonic_s(self) -> float:
        """The time."""
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        """Advance the time; never by less than a nanosecond, the resolution of real clocks."""
        if duration_s < 0:
            raise ValueError("sleep length must be non-negative")
        self.sleeps.append(duration_s)
        self.now_s += max(duration_s * self.early_share, 1e-9) + self.stopped_s
        self.stopped_s = 0.0

    def work(self, duration_s: float) -> None:
        """Advance the time by the work of a tick."""
        self.now_s += duration_s

    def clock(self, period_s: float = PERIOD_S) -> WallClock:
        """A wall clock on this time."""
        return WallClock(period_s, monotonic_s=self.monotonic_s, sleep=self.sleep)
