"""A watcher that remembers what it was told, and one that interrupts."""

from hexctl.study.walking import Silent


class Remembering(Silent):
    """Remembers stages and notes, counts steps, and interrupts after some of the walks.

    Args:
        interrupt_after: number of steps after which it raises KeyboardInterrupt; None for never.
    """

    def __init__(self, interrupt_after: int | None = None) -> None:
        self.stages: list[tuple[str, int]] = []
        self.notes: list[str] = []
        self.steps, self._left = 0, interrupt_after

    def stage(self, name: str, steps: int) -> None:
        self.stages.append((name, steps))

    def step(self, steps: int = 1) -> None:
        self.steps += steps
        if self._left is not None and self.steps >= self._left:
            raise KeyboardInterrupt

    def note(self, text: str) -> None:
        self.notes.append(text)

    @property
    def walks(self) -> int:
        """Number of walks that were to be simulated."""
        return sum(steps for name, steps in self.stages if name.startswith("walks"))
