"""A stop on the disk: it survives a restart of the server, and an unreadable file counts as a stop.

The file is opened at the start and overwritten in place, in one block. A stop is therefore stored even
without free descriptors or disk space, and an interrupted write leaves an unreadable file.
"""

import errno
import fcntl
import hashlib
import os
import re
import threading
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from hexctl.errors import printable
from hexctl.files import atomic_write, read_file, state_folder
from hexctl.wire.links import CLEAR_COMMAND
from hexctl.wire.stop import CLAIM_DIGITS, ESTOP, MAX_BY, MOST_CLAIMS, Stop, new_stop_id
from hexctl.wire.stop_datagram import ID_BYTES

#: How long `close` waits for the last stop to be written.
WRITE_TIMEOUT_S = 2.0

#: Pause between two writes: repeated stops must not wear out the disk.
PAUSE_S = 0.1

#: Pause before a failed write is repeated, for example on a full disk.
AGAIN_S = 1.0

#: Size of the file, larger than all its texts in any characters.
BLOCK_BYTES = 4096

#: Longest reason of a stop, and longest name of a robot or a port, in characters.
MOST_REASON, MOST_NAME = 300, 100


class StoredStop(BaseModel):
    """A stop in the file's format; `robot`, `where` and `at` (UTC) are for readers."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Literal[1] = 1
    robot: str
    where: str
    reason: Annotated[str, Field(min_length=1)]
    stop_id: Annotated[str, Field(pattern=f"^[0-9a-f]{{{2 * ID_BYTES}}}$")]
    at: AwareDatetime
    by: Annotated[str, Field(max_length=MAX_BY)] | None
    claims: Annotated[
        tuple[Annotated[str, Field(max_length=CLAIM_DIGITS)], ...], Field(max_length=MOST_CLAIMS)
    ] = ()

    def __str__(self) -> str:
        """One line for an operator."""
        by = "" if self.by is None else f", asked for by {self.by}"
        return f"{self.reason}, {self.at:%Y-%m-%d %H:%M} UTC{by}, {self.robot} at {self.where}"


_CONTENT: TypeAdapter[StoredStop | None] = TypeAdapter(StoredStop | None)


class StopFile:
    """The file of one robot's stop, written by its own thread: a slow disk delays no tick.

    Args:
        where: port of its servos as typed, or endpoint of its server. Distinguishes robots of one name,
            unless it is a device, which may be renamed after a restart.
        asked_only: store only stops that a client asked for; a simulation stands after a restart.

    Attributes:
        trouble: why the current stop is not stored, or None.
        loaded: description of the loaded stop, or None.
    """

    def __init__(
        self,
        robot: str,
        backend: str,
        where: str,
        *,
        folder: Path | None = None,
        asked_only: bool = False,
        clear: str = CLEAR_COMMAND,
    ) -> None:
        name = re.sub(r"[^A-Za-z0-9_-]", "_", robot)[:40]
        at_device = where.removeprefix("serial:").startswith("/")
        known_by = f"{robot}\n{backend}\n{'' if at_device else where}"
        digest = hashlib.sha256(known_by.encode(errors="replace")).hexdigest()[:12]
        self.path = (state_folder() if folder is None else folder) / f"stop-{name}-{digest}.json"
        self.trouble: str | None = None
        self.loaded: str | None = None
        self._robot, self._where = robot, where
        self._asked_only, self._clear = asked_only, clear
        self._lock: int | None = None
        self._descriptor: int | None = None
        self._wanted: StoredStop | None = None
        self._stop_on_disk: str | None = None
        self._due, self._ended = threading.Event(), False
        self._writer: threading.Thread | None = None

    def load(self) -> StoredStop | None:
        """The stored stop, or None; also tests whether the file can be written.

        An unreadable or invalid file is a stop too. A file that another running server has locked may be that
        of another robot of this name: its stop is in force here, and only that server writes it.
        """
        kept, unread = self._read()
        self._wanted, self._stop_on_disk = kept, None if kept is None else kept.stop_id
        self.loaded = None if kept is None else str(kept) if unread is None else unread
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._own()
            if unread is None:
                self._open(kept)
        except BlockingIOError:
            self.trouble = self._of_another
            self._begin_to_write()  # once the other server has ended
        except OSError as error:
            self.trouble = f"{self.path} cannot be written ({error.strerror})"
        return kept

    @property
    def _of_another(self) -> str:
        return f"{self.path} is that of another {self._robot} that is served now; rename one of them"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the operator after `load`."""
        lines = [] if self.trouble is None else [f"a stop will not survive a restart: {self.trouble}"]
        if self.loaded is not None:
            stopped = f"still stopped ({self.loaded}), as before the restart"
            lines.insert(0, f"{stopped}; {self._clear} when it may move")
        return tuple(printable(line) for line in lines)

    def keep(self, stop: Stop | None) -> None:
        """Queue a stop, or its absence (None), for writing; never waits."""
        kept = stop is not None and (not self._asked_only or stop.by is not None or stop.reason == ESTOP)
        self._wanted = self._content(stop) if kept and stop is not None else None
        if self._wanted is None and self._lock is None:
            self._stop_on_disk = None  # cleared here, and not by the server that wrote it
        if self._writer is None and (self._wanted is not None or self._stop_on_disk is not None):
            self._begin_to_write()
        self._due.set()

    def keeps(self, stop: Stop) -> bool:
        """Whether a stop is on the disk."""
        return self._stop_on_disk == stop.stop_id

    def close(self) -> None:
        """Wait until the last stop is written, unless the disk is too slow."""
        self._ended = True
        self._due.set()
        if self._writer is not None:
            self._writer.join(WRITE_TIMEOUT_S)
        if self._writer is None or not self._writer.is_alive():
            for descriptor in (self._descriptor, self._lock):
                if descriptor is not None:
                    os.close(descriptor)
            self._descriptor = self._lock = None

    def _read(self) -> tuple[StoredStop | None, str | None]:
        try:
            return _CONTENT.validate_json(read_file(self.path, BLOCK_BYTES)), None
        except (FileNotFoundError, NotADirectoryError):
            places = (self.path, *self.path.parents)  # a stop may be behind a dangling link
            link = next((one for one in places if one.is_symlink() and not one.exists()), None)
            if link is None:
                return None, None
            why = f"{link} is a link to nothing"
        except OSError as error:
            why = error.strerror or str(error)
        except ValidationError:
            why = "it is not a stop file"
        unknown = Stop(stop_id=new_stop_id(), reason=ESTOP, since_s=0.0)
        return self._content(unknown), f"{self.path} cannot be read: {why}"

    def _own(self) -> None:
        """Lock the file for this server; raises BlockingIOError while another server has it, or its stop."""
        if self._lock is not None:
            return
        descriptor = os.open(self.path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            loaded, _ = self._read()
            if loaded is not None and loaded.stop_id != self._stop_on_disk and self.trouble is not None:
                raise BlockingIOError(errno.EAGAIN, "it has the stop of another server", str(self.path))
        except BlockingIOError:
            os.close(descriptor)
            raise
        except OSError:  # a file system without locks
            pass
        self._lock = descriptor

    def _open(self, content: StoredStop | None) -> None:
        """Keep the file open, created with `content` if missing; raises OSError."""
        if not self.path.exists():
            atomic_write(self.path, _block(content).decode())
        self._descriptor = os.open(self.path, os.O_RDWR)

    def _begin_to_write(self) -> None:
        """A thread that cannot start is trouble, but does not prevent the stop."""
        writer = threading.Thread(target=self._write, name="stop file", daemon=True)
        try:
            writer.start()
        except RuntimeError as error:  # the computer has no thread left
            self.trouble = f"{self.path} cannot be written ({error})"
        else:
            self._writer = writer

    def _write(self) -> None:
        while not self._ended or self._due.is_set():
            self._due.wait(None if self.trouble is None else AGAIN_S)
            self._due.clear()
            wanted = self._wanted
            try:
                self._own()
                if wanted is not None or self._stop_on_disk is not None:
                    self._put(wanted)
            except BlockingIOError:
                self.trouble = self._of_another
            except OSError as error:
                self.trouble = f"{self.path} cannot be written ({error.strerror})"
            else:
                self.trouble, self._stop_on_disk = None, None if wanted is None else wanted.stop_id
            time.sleep(0 if self._ended else PAUSE_S)

    def _put(self, content: StoredStop | None) -> None:
        """Overwrite the file, or recreate a removed or invalid one; raises OSError."""
        if self._descriptor is not None and os.fstat(self._descriptor).st_nlink > 0:
            os.pwrite(self._descriptor, _block(content), 0)
            os.fsync(self._descriptor)
            return
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        atomic_write(self.path, _block(content).decode())
        with suppress(OSError):  # it is on the disk; the next write may replace it likewise
            self._open(content)

    def _content(self, stop: Stop) -> StoredStop:
        reason = ESTOP if self._asked_only else stop.reason  # a simulation stands after a restart
        return StoredStop(
            robot=_storable(self._robot, MOST_NAME),
            where=_storable(self._where, MOST_NAME),
            reason=_storable(reason, MOST_REASON),
            stop_id=stop.stop_id,
            at=datetime.now(UTC),
            by=stop.by,
            claims=stop.claims,
        )


def _block(content: StoredStop | None) -> bytes:
    return _CONTENT.dump_json(content).ljust(BLOCK_BYTES)


def _storable(text: str, most: int) -> str:
    """A driver's text may not be valid UTF-8."""
    return text[:most].encode(errors="replace").decode()
