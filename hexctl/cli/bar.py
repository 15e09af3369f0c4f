"""The progress bar that all commands share: on stderr, gone when it is done."""

from typing import Any


def make_bar(counter: str | None = None) -> Any:
    """Return a rich progress bar with the time left, not yet started.

    Args:
        counter: format of how far it is; None counts whole things, done of all.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn() if counter is None else TextColumn(counter),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
