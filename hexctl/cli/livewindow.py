"""The window of a walk that is shown while it goes on; without a screen the walk goes on without it."""

from hexctl.cli.console import print_note
from hexctl.errors import RecordingError
from hexctl.record.live import LiveView
from hexctl.record.viewer import check_display


def open_window() -> LiveView | None:
    """Return a new window; None, and a word about it, where there is no screen: that must not cost a walk."""
    try:
        check_display()
    except RecordingError as error:
        print_note(f"hexctl: {error}; going on without")
        return None
    return LiveView()
