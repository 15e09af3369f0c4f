"""A stop on the disk: it survives a restart of the server, and a file that cannot be read counts as one."""

import hashlib
import os
import re
import threading
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hexctl.files import atomic_write
from hexctl.serve.stops.stop import ESTOP, ID_BYTES, Stop, new_stop_id
from hexctl.wire.links import CLEAR_COMMAND

#: How long closing waits for the last stop to be written.
WRITE_TIMEOUT_S = 2.0

#: Pause between two writes: whoever stops again and again does not wear the disk out.
PAUSE_S = 0.1

#: Pause before a write that failed is tried again, as on a disk that was full.
AGAIN_S = 1.0

#: Longest file that is read.
MAX_BYTES = 4096

VERSION = 1


class KeptStop(BaseModel):
    """Content of the file.

    Attributes:
        version: of this format, 1.
        robot: name of the robot, for readers.
        reason: as `Guard.stopped` has it.
        stop_id: by which it is cleared.
        at: when it was stopped, UTC by the clock of that time, for readers.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Annotated[int, Field(ge=VERSION, le=VERSION)] = VERSION
    robot: str
    reason: Annotated[str, Field(min_length=1)]
    stop_id: Annotated[str, Field(pattern=f"^[0-9a-f]{{{2 * ID_BYTES}}}$")]
    at: datetime


def state_folder() -> Path:
    """Where servers keep their state: what systemd gave, or the user's own folder for it (XDG)."""
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    home = os.environ.get("XDG_STATE_HOME")
    return (Path(home) if home else Path.home() / ".local" / "state") / "hexctl"


class StopFile:
    """The file of one robot's stop. Writing has a thread of its own: a slow disk costs no tick.

    Args:
        robot: name of the robot.
        place: what tells robots of one name apart: port of the servos, or endpoint of the server.
        folder: where the file lies; None is `state_folder()`.
        asked_only: keep only stops that somebody asked for, as of a simulation, which stands up anew.
        clear: command that ends a stop of this robot, for the warning.

    Attributes:
        path: of the file.
        trouble: why the stop of now is not kept, or None.
        found: what was loaded, in words; None where there was no stop.
    """

    def __init__(
        self,
        robot: str,
        place: str,
        *,
        folder: Path | None = None,
        asked_only: bool = False,
        clear: str = CLEAR_COMMAND,
    ) -> None:
        name = re.sub(r"[^A-Za-z0-9_-]", "_", robot)[:40]
        mark = hashlib.sha256(f"{robot}\n{place}".encode()).hexdigest()[:12]
        self.path = (state_folder() if folder is None else folder) / f"stop-{name}-{mark}.json"
        self.trouble: str | None = None
        self.found: str | None = None
        self._robot, self._asked_only, self._clear = robot, asked_only, clear
        self._wanted: Stop | None = None
        self._on_disk: str | None = None
        self._due, self._ended = threading.Event(), False
        self._writer: threading.Thread | None = None

    def load(self) -> KeptStop | None:
        """The stop that was kept, None where there is none.

        A file that cannot be read, or is none of these, is a stop too. Notes whether one could be written.
        """
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not os.access(self.path.parent, os.W_OK):
                self.trouble = f"{self.path.parent} may not be written"
        except OSError as error:
            self.trouble = f"{self.path.parent} cannot be made ({error.strerror})"
        try:
            with self.path.open("rb") as file:
                kept = KeptStop.model_validate_json(file.read(MAX_BYTES))
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValidationError):
            kept = self._content(ESTOP, new_stop_id())
            self.found = f"{self.path} cannot be read"
        else:
            self.found = f"{kept.reason}, {kept.at:%Y-%m-%d %H:%M} UTC"
        self._on_disk = kept.stop_id
        return kept

    @property
    def warnings(self) -> tuple[str, ...]:
        """What an operator must know once it was loaded."""
        trouble = () if self.trouble is None else (f"a stop will not survive a restart: {self.trouble}",)
        if self.found is None:
            return trouble
        return (
            f"still stopped ({self.found}), as before the restart; {self._clear} when it may move",
            *trouble,
        )

    def keep(self, stop: Stop | None) -> None:
        """Write a stop, or remove it for None, soon; never waits."""
        asked = stop is not None and (stop.reason == ESTOP or not self._asked_only)
        self._wanted = stop if asked else None
        if self._writer is None and (self._wanted is not None or self._on_disk is not None):
            self._writer = threading.Thread(target=self._write, name="stop file", daemon=True)
            self._writer.start()
        self._due.set()

    def keeps(self, stop: Stop) -> bool:
        """Whether a stop is on the disk."""
        return self._on_disk == stop.stop_id

    def close(self) -> None:
        """Wait for the last stop to be written, as long as the disk takes no longer than usual."""
        self._ended = True
        self._due.set()
        if self._writer is not None:
            self._writer.join(WRITE_TIMEOUT_S)

    def _write(self) -> None:
        while not self._ended or self._due.is_set():
            self._due.wait(None if self.trouble is None else AGAIN_S)
            self._due.clear()
            wanted = self._wanted
            try:
                self._put(wanted)
            except OSError as error:
                self.trouble = f"{self.path} cannot be written ({error.strerror})"
            else:
                self.trouble, self._on_disk = None, None if wanted is None else wanted.stop_id
            time.sleep(0 if self._ended else PAUSE_S)

    def _put(self, wanted: Stop | None) -> None:
        if wanted is None:
            with suppress(FileNotFoundError):
                self.path.unlink()
            return
        content = self._content(wanted.reason, wanted.stop_id)
        atomic_write(self.path, content.model_dump_json() + "\n")

    def _content(self, reason: str, stop_id: str) -> KeptStop:
        reason = reason.encode(errors="replace").decode()  # a driver may say what no file can have
        return KeptStop(robot=self._robot, reason=reason, stop_id=stop_id, at=datetime.now(UTC))
