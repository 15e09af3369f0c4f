"""The demo: a leg fails during a walk, the robot recovers, and a gait for the other legs is searched.

    result = demo()
    print(result.recovered.trial.distance_m, result.adaptation.best, result.picture)

The walk is made with and without recovery; the search is `hexctl.adapt(failed_leg=5, budget=20)`. The
simulated world is held out: no prior and no threshold was made with it.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from hexctl.adapt.adaptation import Adaptation, AdaptationResult, OnBegin
from hexctl.adapt.runner import NotBegunError
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.store import RUNS
from hexctl.adapt.setting import Note, log_note
from hexctl.adapt.trial_loop import OnStored
from hexctl.errors import HexctlError, InputError, RecordingError
from hexctl.export.export import export
from hexctl.files import ALLOWED_FOLDER, check_writable, folder_trouble
from hexctl.robot.failure import FailureEvent
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.runs.run import RunResult, run
from hexctl.waiting import StopRequested, never_stop

#: The robot, its gait on six legs, and the world. Worlds of this family from 500 on are held out. This is
#: the first in which the failure shows: without recovery, the robot covers at most 70 % of the distance, and
#: without a search, no gait ends within 10 cm of its line in open loop.
ROBOT, GAIT, WORLD = "ant", "tripod", "transfer:504"

#: Failure and its time, and the length of the walk.
EVENT, WALK_S = parse_failure_event("5:locked@6.3"), 15.0

#: Names of the recoveries that the two walks use.
WALK_ON, RECOVER = "walk-on", "glide"

#: The race begins just before the failure.
PICTURE: dict[str, Any] = {
    "captions": ("no recovery", "with recovery"),
    "from_s": 5.4,
    "duration_s": 8.0,
    "width_px": 720,
    "fps": 12.5,
}

OnWalk = Callable[[RunResult], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoResult:
    """Result of the demo; parts after an interrupt are None.

    Attributes:
        world: of the walks and of the search.
        folder: of both recordings, and of the picture.
        walked_on: the walk without recovery.
        recovered: the walk with recovery.
        adaptation: the search for a gait that goes straight without the leg and without feedback.
        picture: GIF of both walks as a race.
        no_picture: why there is none.
    """

    event: FailureEvent
    world: str
    folder: Path
    walked_on: RunResult | None = None
    recovered: RunResult | None = None
    adaptation: AdaptationResult | None = None
    picture: Path | None = None
    no_picture: str | None = None

    @property
    def interrupted(self) -> bool:
        """Whether a stop was requested before the end of the demo."""
        return self.adaptation is None or self.adaptation.ended == "interrupted"

    @property
    def recordings(self) -> tuple[Path, ...]:
        """Recordings of the walks, first the one without recovery."""
        walks = (self.walked_on, self.recovered)
        return tuple(walk.recording for walk in walks if walk is not None and walk.recording is not None)

    def to_dict(self) -> dict[str, Any]:
        """The result as `hexctl demo --json` prints it."""
        walks = {"walked_on": self.walked_on, "recovered": self.recovered}
        return {
            "event": str(self.event),
            "world": self.world,
            **{name: None if walk is None else walk.to_dict() for name, walk in walks.items()},
            "adaptation": None if self.adaptation is None else self.adaptation.to_dict(),
            "picture": None if self.picture is None else str(self.picture),
            "no_picture": self.no_picture,
        }


def demo(
    *,
    budget: int = 20,
    folder: Path | str = RUNS,
    note: Note = log_note,
    on_walk: OnWalk | None = None,
    on_begin: OnBegin | None = None,
    on_stored: OnStored | None = None,
    stop_requested: StopRequested = never_stop,
) -> DemoResult:
    """Let a leg fail during a walk, recover, search for a gait of the others, and draw the walks as a race.

    Args:
        budget: most trials of the search.
        folder: of the session, and of a folder for the walks.
        note: takes notes for the user; logged by default.
        on_walk: called with each of the two walks, first the one without recovery.
        on_begin: called with the session before its first trial.
        on_stored: called with the session and each stored walk of the search.
        stop_requested: called every tick; True ends the demo softly.

    Raises InputError for an invalid budget or folder, MissingExtraError without MuJoCo or Rerun.
    """
    folder = Path(folder)
    check_writable(folder)
    spec = new_spec(failure=EVENT.failure, budget=budget, world=WORLD, folder=folder, note=note)
    into = _new_folder(folder)
    result = DemoResult(event=EVENT, world=WORLD, folder=into)
    for name, recovery in (("walked_on", WALK_ON), ("recovered", RECOVER)):
        recording = into / f"{name.replace('_', '-')}.rrd"
        try:
            walk = walk_and_fail(recovery, recording, stop_requested=stop_requested)
        finally:
            _remove_empty(into)  # interrupted before anything was recorded
        changed: dict[str, Any] = {name: walk}
        result = replace(result, **changed)
        if stop_requested():
            return result
        if on_walk is not None:
            on_walk(walk)
    # The executor waits for its thread: one that draws while Python ends crashes it.
    with ThreadPoolExecutor(1, "race") as executor:
        drawing = executor.submit(_drawn, result, stop_requested)
        try:
            adaptation = Adaptation(spec, folder=folder, note=note).run(
                on_begin=on_begin, on_stored=on_stored, stop_requested=stop_requested
            )
        except NotBegunError:
            return result
    return replace(result, adaptation=adaptation, **drawing.result())


def walk_and_fail(
    recovery: str, recording: Path | None, *, world: str = WORLD, stop_requested: StopRequested = never_stop
) -> RunResult:
    """Walk on the line until the leg of the demo fails, and continue by a recovery; None records nothing."""
    try:
        return run(
            robot=ROBOT,
            gait=GAIT,
            world=world,
            hold="line",
            failure=EVENT,
            recovery=recovery,
            duration_s=WALK_S,
            record=False if recording is None else recording,
            stop_requested=stop_requested,
        )
    except InputError as error:
        if not isinstance(cause := error.__cause__, OSError):
            raise
        # The demo has no option to record elsewhere.
        trouble = f"{recording}: cannot be written ({cause.strerror})"
        raise RecordingError(f"{trouble}; {ALLOWED_FOLDER}") from cause


class _StoppedError(Exception):
    """The picture is not needed any more."""


def _drawn(walked: DemoResult, stop_requested: StopRequested) -> dict[str, Any]:
    """Draw both walks as a race; return the picture, or why there is none, as a field of the result."""

    def go_on(_done: int, _total: int) -> None:
        if stop_requested():
            raise _StoppedError

    output = walked.folder / "rescue.gif"
    try:
        return {"picture": export(*walked.recordings, output=output, on_progress=go_on, **PICTURE)}
    except _StoppedError:
        return {}
    except HexctlError as error:
        return {"no_picture": str(error)}
    except Exception as error:  # noqa: BLE001  the result of the search must not be lost
        return {"no_picture": f"{type(error).__name__}: {error}"}


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _new_folder(folder: Path) -> Path:
    """Raises InputError if it cannot be made."""
    stem, number = f"demo-{datetime.now():%Y%m%d-%H%M%S}", 1
    while True:
        path = folder / (stem if number == 1 else f"{stem}_{number}")
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            number += 1
        except OSError as error:
            raise InputError(f"{folder_trouble(folder, error)}; {ALLOWED_FOLDER}") from error
        else:
            return path
