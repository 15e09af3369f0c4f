"""The matrix: its cells, several rigs at a time, until all repetitions are done."""

import shutil
import subprocess
import tempfile
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from faults.backend import BACKENDS
from faults.cell import inject
from faults.fault import FAULTS
from faults.injection import TooLateError
from faults.measurement import Outcome
from faults.phase import PHASES
from faults.process import ROOT, LostError
from faults.results import Results, done
from faults.rig import Rig
from faults.sense import cells

#: How often an injection is tried for which the rig or the machine fails.
TRIES = 4

#: A new rig is made after this many injections: the file of its truth has an end.
MOST_INJECTIONS = 60


def commit() -> str:
    """Commit of this code, with `+` where it was changed since; empty outside of a repository."""
    git = ("git", "-C", str(ROOT))
    try:
        named = subprocess.run(
            [*git, "rev-parse", "--short=8", "HEAD"], capture_output=True, text=True, check=True
        )
        changed = subprocess.run(
            [*git, "diff", "--quiet", "HEAD", "--", "hexctl", "faults/*.py"], check=False
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return named.stdout.strip() + ("+" if changed.returncode else "")


@dataclass(frozen=True, slots=True)
class Job:
    """Injections of one fault into one backend, in all phases that are asked for.

    Attributes:
        backend: name.
        fault: name.
        wanted: phases and repetitions.
    """

    backend: str
    fault: str
    wanted: tuple[tuple[str, int], ...]


def jobs(only: Iterable[str], repetitions: int, outcomes: Iterable[Outcome]) -> list[Job]:
    """What is still to be run.

    Args:
        only: `fault`, `fault/backend` or `fault/backend/phase`, `*` for any; nothing is all.
        repetitions: of each cell.
        outcomes: that there are.
    """
    have, patterns = done(outcomes), [pattern.split("/") for pattern in only]
    wanted: dict[tuple[str, str], list[tuple[str, int]]] = {}
    for repetition in range(repetitions):
        for fault, backend, phase in cells():
            names = (fault, backend, phase)
            if patterns and not any(_matches(pattern, names) for pattern in patterns):
                continue
            if (*names, repetition) not in have:
                wanted.setdefault((backend, fault), []).append((phase, repetition))
    # A motion that goes on after one injection is met by the next one.
    return [
        Job(backend, fault, tuple(sorted(each, key=lambda one: list(PHASES).index(one[0]))))
        for (backend, fault), each in wanted.items()
    ]


def _matches(pattern: list[str], names: tuple[str, str, str]) -> bool:
    return all(part in ("*", "", name) for part, name in zip(pattern, names, strict=False))


class Matrix:
    """Runs jobs on several rigs at a time.

    Args:
        results: to which outcomes are added.
        say: called with a line for each outcome, and for each that could not be had.

    Attributes:
        broken: injections that ended with an error of the matrix itself.
    """

    def __init__(self, results: Results, say: Callable[[Outcome | str], None]) -> None:
        self._results, self._say, self.broken = results, say, 0
        self._commit = commit()
        self._jobs: deque[Job] = deque()
        self._over = threading.Event()

    def run(self, work: Iterable[Job], rigs: int) -> None:
        """Run all jobs; Ctrl-C ends them all, and what was measured stays."""
        self._jobs = deque(work)
        lanes = [threading.Thread(target=self._lane) for _ in range(max(1, rigs))]
        for lane in lanes:
            lane.start()
        try:
            for lane in lanes:
                while lane.is_alive():
                    lane.join(0.5)
        finally:
            self._over.set()
            for lane in lanes:
                lane.join()

    def _lane(self) -> None:
        while not self._over.is_set():
            try:
                job = self._jobs.popleft()
            except IndexError:
                return
            folder = Path(tempfile.mkdtemp(prefix="hexctl-faults-"))
            try:
                self._do(job, folder)
            finally:
                shutil.rmtree(folder, ignore_errors=True)

    def _do(self, job: Job, folder: Path) -> None:
        with ExitStack() as stack:
            holder = _RigHolder(job, folder)
            stack.callback(holder.drop)
            for phase, repetition in job.wanted:
                if self._over.is_set():
                    return
                try:
                    self._one(holder, job, phase, repetition)
                except Exception:  # noqa: BLE001  one injection must not end the others
                    self.broken += 1
                    self._say(f"{job.fault}/{job.backend}/{phase} {repetition}: {traceback.format_exc()}")
                    holder.drop()

    def _one(self, holder: "_RigHolder", job: Job, phase: str, repetition: int) -> None:
        fault, trouble = FAULTS[job.fault], ""
        for _ in range(TRIES):
            try:
                rig = holder.rig()
                outcome = inject(rig, fault, phase, repetition)
            except (LostError, TooLateError) as error:
                trouble = f"{type(error).__name__}: {error}"
                holder.drop()
                if self._over.is_set():
                    return
                self._results.add_not_measured(job.fault, job.backend, phase, trouble)
                continue
            outcome = replace(outcome, commit=self._commit)
            self._results.add(outcome)
            self._say(outcome)
            self._clean(holder, outcome)
            return
        self._say(f"{job.fault}/{job.backend}/{phase} {repetition}: not measured: {trouble}")

    def _clean(self, holder: "_RigHolder", outcome: Outcome) -> None:
        """Leave a rig in which the next injection can begin, or none."""
        fault = FAULTS[outcome.fault]
        # The next controller takes over a robot whose commands expired.
        latched = any(not stop.startswith("expired") for stop in outcome.stops)
        if fault.breaks == "rig" or latched or outcome.fell:
            holder.drop()
            return
        rig = holder.current
        if rig is None:
            return
        if fault.breaks == "controller" or outcome.ended or outcome.unneeded:
            rig.drop_controller()


class _RigHolder:
    """The rig of a job, made when it is needed and as often as it is.

    Attributes:
        current: the rig that runs, None without one.
    """

    def __init__(self, job: Job, folder: Path) -> None:
        self._job, self._folder = job, folder
        self._stack, self._count, self._made = ExitStack(), 0, 0
        self.current: Rig | None = None

    def rig(self) -> Rig:
        """The rig for an injection, running."""
        self._count += 1
        if self._count > MOST_INJECTIONS:
            self.drop()
        if self.current is None:
            self._count, self._made = 1, self._made + 1
            (folder := self._folder / str(self._made)).mkdir()
            self.current = self._stack.enter_context(
                Rig(
                    BACKENDS[self._job.backend],
                    folder,
                    relayed=FAULTS[self._job.fault].relayed,
                    seed=self._made,
                )
            )
        return self.current

    def drop(self) -> None:
        """End the rig."""
        self.current = None
        self._stack.close()
