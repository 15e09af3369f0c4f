"""A stop on the disk: it survives a restart of the server, and a file that cannot be read counts as one."""

import hashlib
import os
import re
import threading
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from hexctl.errors import printable
from hexctl.files import atomic_write, read_file
from hexctl.serve.stops.ready_draft import ReadyDraft
from hexctl.serve.stops.state_folder import state_folder
from hexctl.serve.stops.stop import CLAIM_DIGITS, ESTOP, ID_BYTES, Stop, new_stop_id
from hexctl.serve.stops.stop_place import StopPlace
from hexctl.wire.links import CLEAR_COMMAND

#: How long closing waits for the last stop to be written.
WRITE_TIMEOUT_S = 2.0

#: Pause between two writes: a client that stops again and again does not wear the disk out.
PAUSE_S = 0.1

#: Pause before a write that failed is tried again, as on a disk that was full.
AGAIN_S = 1.0

#: Longest file that is read.
MAX_BYTES = 8192

#: Places at which a stop of another place was cleared, that are remembered.
MOST_CLEARED = 64

#: Hexadecimal digits of a place in the name of a file.
MARK_DIGITS = 12

VERSION = 1


class KeptStop(BaseModel):
    """Content of the file.

    Attributes:
        version: of this format, 1.
        robot: name of the robot, for readers.
        reason: as `Guard.stopped` has it.
        stop_id: by which it is cleared.
        at: when it was stopped, UTC by the clock of that time, for readers.
        backend: as `StopPlace` has it, and so the next three; None if another file was not readable.
        where: port of the servos, or endpoint of the server.
        serial_number: of the adapter at that port.
        location: of that adapter.
        by: who asked for it, None where no client did.
        cleared: marks of the places at which it was taken over from here, and cleared since.
        claims: as `Stop` has them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Annotated[int, Field(ge=VERSION, le=VERSION)] = VERSION
    robot: str
    reason: Annotated[str, Field(min_length=1)]
    stop_id: Annotated[str, Field(pattern=f"^[0-9a-f]{{{2 * ID_BYTES}}}$")]
    at: AwareDatetime
    backend: str | None
    where: str | None
    serial_number: str | None
    location: str | None
    by: str | None
    cleared: tuple[str, ...] = ()
    claims: tuple[Annotated[str, Field(max_length=CLAIM_DIGITS)], ...] = ()

    @property
    def place(self) -> StopPlace | None:
        """Where the robot was served; None if that is not known."""
        if self.backend is None or self.where is None:
            return None
        return StopPlace(
            backend=self.backend,
            where=self.where,
            serial_number=self.serial_number,
            location=self.location,
        )

    def __str__(self) -> str:
        """In words, for an operator."""
        by = "" if self.by is None else f", asked for by {self.by}"
        return f"{self.reason}, {self.at:%Y-%m-%d %H:%M} UTC{by}"


class _TakenOver(NamedTuple):
    """A stop that was kept for another place; `stop_id` is None for a file that cannot be read."""

    path: Path
    stop_id: str | None


class StopFile:
    """The file of one robot's stop. Writing has a thread of its own: a slow disk costs no tick.

    It is found again by the adapter of the robot's servos, where that has a serial number or stays in its
    socket. A stop that was kept for a robot of this name at a device that may be the same is in force here
    too; it is left to its own place as well, and once cleared here it is not taken over again.

    Args:
        robot: name of the robot.
        place: what tells robots of one name apart.
        folder: where the file lies; None is `state_folder()`.
        asked_only: keep only stops that a client asked for, as of a simulation, which stands after a restart.
        clear: command that ends a stop of this robot, for the warning.

    Attributes:
        path: of the file.
        trouble: why the stop of now is not kept, or None.
        found: what was loaded, in words; None where there was no stop.
    """

    def __init__(
        self,
        robot: str,
        place: StopPlace,
        *,
        folder: Path | None = None,
        asked_only: bool = False,
        clear: str = CLEAR_COMMAND,
    ) -> None:
        name = re.sub(r"[^A-Za-z0-9_-]", "_", robot)[:40]
        self._mark = hashlib.sha256(f"{robot}\n{place.key}".encode()).hexdigest()[:MARK_DIGITS]
        self._siblings = f"stop-{name}-{'?' * MARK_DIGITS}.json"
        self.path = (state_folder() if folder is None else folder) / f"stop-{name}-{self._mark}.json"
        self.trouble: str | None = None
        self.found: str | None = None
        self._robot, self._place = robot, place
        self._asked_only, self._clear = asked_only, clear
        self._taken_over: list[_TakenOver] = []
        self._unread: dict[Path, str] = {}
        self._elsewhere: list[str] = []
        self._wanted: Stop | None = None
        self._on_disk: str | None = None
        self._due, self._ended = threading.Event(), False
        self._writer: threading.Thread | None = None
        self._draft: ReadyDraft | None = None

    def load(self) -> KeptStop | None:
        """The stop that was kept, None where there is none.

        A file that cannot be read, or is none of these, is a stop too. Notes whether one could be written.
        """
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not os.access(self.path.parent, os.W_OK):
                self.trouble = f"{self.path.parent} may not be written"
            self._draft = ReadyDraft(self.path)
        except OSError as error:
            self.trouble = f"{self.path.parent} cannot be made ({error.strerror})"
        own, others = self._read(self.path), self._of_this_robot_elsewhere()
        kept = own
        if own is not None:
            self._on_disk = own.stop_id
        elif others:
            kept = self._copied(max(others, key=lambda each: each.at))
        told = [] if own is None else [self._in_words(own, self.path)]
        told += [self._in_words(each, one.path) for one, each in zip(self._taken_over, others, strict=True)]
        self.found = "; ".join(told) or None
        return kept

    @property
    def warnings(self) -> tuple[str, ...]:
        """What an operator must know once it was loaded."""
        lines = [] if self.trouble is None else [f"a stop will not survive a restart: {self.trouble}"]
        another = f"a stop of another {self._robot} is kept, and not in force here"
        lines += [f"{another}: {each}" for each in self._elsewhere]
        if self.found is not None:
            stopped = f"still stopped ({self.found}), as before the restart"
            lines.insert(0, f"{stopped}; {self._clear} when it may move")
        return tuple(printable(line) for line in lines)

    def keep(self, stop: Stop | None) -> None:
        """Write a stop, or remove it for None, soon; never waits."""
        kept = stop is not None and (not self._asked_only or stop.by is not None or stop.reason == ESTOP)
        self._wanted = stop if kept else None
        on_disk = self._on_disk is not None or bool(self._taken_over)
        if self._writer is None and (self._wanted is not None or on_disk):
            self._begin_to_write()
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
        if self._draft is not None and (self._writer is None or not self._writer.is_alive()):
            self._draft.close()

    def _begin_to_write(self) -> None:
        """Start the thread that writes; one that cannot be started is trouble, and keeps no stop back."""
        writer = threading.Thread(target=self._write, name="stop file", daemon=True)
        try:
            writer.start()
        except RuntimeError as error:  # the computer has no thread left
            self.trouble = f"{self.path} cannot be written ({error})"
        else:
            self._writer = writer

    def _of_this_robot_elsewhere(self) -> list[KeptStop]:
        """Stops that were kept for a robot of this name, and may be this one; notes those that are not."""
        if not self._place.at_device:
            return []
        found = []
        for path in sorted(self.path.parent.glob(self._siblings)):
            kept = None if path == self.path else self._read(path)
            if kept is None or self._mark in kept.cleared or kept.robot != self._robot:
                continue
            if kept.place is None or self._place.may_be(kept.place):
                self._taken_over.append(_TakenOver(path, self._id_in(kept, path)))
                found.append(kept)
            elif kept.place.backend == self._place.backend and kept.place.at_device:
                self._elsewhere.append(f"{kept}, {kept.place}")
        return found

    def _read(self, path: Path) -> KeptStop | None:
        """A stop in a file, None where there is no file."""
        self._unread.pop(path, None)
        try:
            return KeptStop.model_validate_json(read_file(path, MAX_BYTES))
        except (FileNotFoundError, NotADirectoryError):
            link = _dangling_link(path)
            if link is None:
                return None
            self._unread[path] = f"{link} is a link to nothing"
        except OSError as error:
            self._unread[path] = error.strerror or str(error)
        except ValidationError:
            self._unread[path] = "it is not a stop file"
        unread = self._content(ESTOP, new_stop_id())
        return unread if path == self.path else unread.model_copy(update={"backend": None})

    def _id_in(self, kept: KeptStop, path: Path) -> str | None:
        """Id that a file has, None for one that could not be read."""
        return None if path in self._unread else kept.stop_id

    def _in_words(self, kept: KeptStop, path: Path) -> str:
        """A stop that is in force, and where it was kept unless that is here."""
        if path in self._unread:
            return f"{path} cannot be read: {self._unread[path]}"
        if path == self.path:
            return str(kept)
        place = "a place that is not known" if kept.place is None else str(kept.place)
        return f"{kept}, kept for {kept.robot}, {place}, which may be this one"

    def _copied(self, kept: KeptStop) -> KeptStop:
        """A stop that was kept elsewhere, kept here too: it stays if it is cleared there."""
        own = self._content(kept.reason, kept.stop_id, kept.by, kept.claims)
        own = own.model_copy(update={"at": kept.at})
        try:
            atomic_write(self.path, own.model_dump_json() + "\n")
        except OSError as error:
            self.trouble = f"{self.path} cannot be written ({error.strerror})"
        else:
            self._on_disk = own.stop_id
        return own

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
        if wanted is not None:
            reason = ESTOP if self._asked_only else wanted.reason  # what has fallen stands after a restart
            content = self._content(reason, wanted.stop_id, wanted.by, wanted.claims)
            self._replace(content.model_dump_json() + "\n")
            return
        with suppress(FileNotFoundError):
            self.path.unlink()
        while self._taken_over:
            self._cleared_at(self._taken_over[-1])
            self._taken_over.pop()

    def _replace(self, text: str) -> None:
        """Replace the file, also where a flood of connections has taken all descriptors."""
        try:
            if self._draft is not None:
                self._draft.write(text.encode())
                return
        except OSError:  # it may be opened again, or the disk may refuse: the usual way says which
            pass
        atomic_write(self.path, text)

    def _cleared_at(self, taken: _TakenOver) -> None:
        """Note in the file of another place that its stop was cleared here, if it has that stop still."""
        kept = self._read(taken.path)
        if kept is not None and self._id_in(kept, taken.path) == taken.stop_id:
            cleared = (*kept.cleared, self._mark)[-MOST_CLEARED:]
            atomic_write(taken.path, kept.model_copy(update={"cleared": cleared}).model_dump_json() + "\n")

    def _content(
        self, reason: str, stop_id: str, by: str | None = None, claims: tuple[str, ...] = ()
    ) -> KeptStop:
        reason = reason.encode(errors="replace").decode()  # a driver may say what no file can have
        return KeptStop(
            robot=self._robot,
            reason=reason,
            stop_id=stop_id,
            at=datetime.now(UTC),
            by=by,
            claims=claims,
            backend=self._place.backend,
            where=self._place.where,
            serial_number=self._place.serial_number,
            location=self._place.location,
        )


def _dangling_link(path: Path) -> Path | None:
    """The link that leads nowhere, of a path and the folders above it: a stop may lie behind it."""
    return next((one for one in (path, *path.parents) if one.is_symlink() and not one.exists()), None)
