"""Repertoires on disk: built ones and shipped ones, saved, checked when they are read, and found."""

import io
import json
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.control.monitor.repertoire import BodySymmetry, Candidate, Repertoire, Situation
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import HexctlError, InputError, check_type
from hexctl.files import ARCHIVE_DAMAGE, atomic_write, damage_reason, open_archive
from hexctl.robot.configs import config_root
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

FORMAT, VERSION = "hexctl repertoire", 1

SUFFIX = ".npz"

#: Folder of the repertoires that were built, in the folder of sessions and recordings, and of shipped ones.
REPERTOIRES = "repertoires"


class RepertoireFileError(HexctlError, OSError):
    """A repertoire cannot be written."""


def save_repertoire(repertoire: Repertoire, path: Path) -> None:
    """Write a repertoire; the file is the old one or the new one at any moment.

    Raises RepertoireFileError when the disk refuses.
    """
    head = {"format": FORMAT, "version": VERSION, "digest": repertoire.digest(), **repertoire.head}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, head=np.array(json.dumps(head)), **repertoire.arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, buffer.getvalue())
    except OSError as error:
        raise RepertoireFileError(f"repertoire: {path} cannot be written: {error.strerror}") from error


_DAMAGE: tuple[type[Exception], ...] = (*ARCHIVE_DAMAGE, AttributeError)


def load_repertoire(path: Path | str) -> Repertoire:
    """Repertoire of a file.

    Raises InputError for a file that is not one, is of another version, is cut off or was altered.
    """
    check_type(path, (str, Path), "repertoire", "the path of a file")
    try:
        with open_archive(path) as file:
            head = json.loads(str(file["head"]))
            arrays = {name: file[name].astype(float) for name in ("speeds", "costs") if name in file.files}
    except FileNotFoundError:
        raise InputError(
            f"repertoire: no file at {str(path)!r}; allowed: a file of hexctl prior build --repertoire"
        ) from None
    except _DAMAGE as error:
        raise _refused(path, f"it is not a repertoire, or cut off ({damage_reason(error)})") from error
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise _refused(path, "it is not a repertoire")
    if head.get("version") != VERSION:
        raise _refused(path, f"it has version {head.get('version')}, this hexctl reads {VERSION}")
    try:
        repertoire = _made(head, arrays)
        intact = repertoire.digest() == head["digest"]
    except _DAMAGE as error:
        raise _refused(path, f"it is damaged ({damage_reason(error)})") from error
    if not intact:
        raise _refused(path, "it was altered after it was built")
    return repertoire


def _made(head: dict[str, Any], arrays: dict[str, FloatArray]) -> Repertoire:
    """Repertoire of what its file holds."""
    situations, first = [], 0
    for values in head["situations"]:
        candidates = tuple(Candidate.from_dict(one) for one in values["candidates"])
        shape = len(candidates), int(values["walks"])
        last = first + shape[0] * shape[1]
        situations.append(
            Situation(
                failed=tuple((leg, kind, joint) for leg, kind, joint in values["failed"]),
                heading_deg=values["heading_deg"],
                candidates=candidates,
                speeds=arrays["speeds"][first:last].reshape(shape),
                costs=arrays["costs"][first:last].reshape(shape),
            )
        )
        first = last
    names = ("robot", "robot_fingerprint", "pace_hz", "amplitude", "height", "direction_step_deg", "origin")
    symmetries = [BodySymmetry(**one | {"legs": tuple(one["legs"])}) for one in head["symmetries"]]
    return Repertoire(
        **{name: head[name] for name in names}, symmetries=tuple(symmetries), situations=tuple(situations)
    )


def _refused(path: Path | str, why: str) -> InputError:
    return InputError(
        f"repertoire {path}: {why}; allowed: a repertoire as hexctl prior build --repertoire writes it"
    )


def describe_repertoire(path: Path | str) -> dict[str, Any]:
    """What a repertoire has, as plain JSON values; raises InputError as `load_repertoire` does.

    `others` counts the situations in which another gait than the safest is best.
    """
    found = load_repertoire(path)
    kinds = [(len(one.failed), *one.failed[0][1:]) for one in found.situations]
    words = {count: [f"{kind}:{joint}" if joint else kind for n, kind, joint in kinds if n == count]
             for count in (1, 2)}  # fmt: skip
    return {
        "robot": found.robot,
        "pace_hz": found.pace_hz,
        "amplitude": found.amplitude,
        "height": found.height,
        "legs": list(dict.fromkeys(words[1])),
        "pairs": list(dict.fromkeys(words[2])),
        "directions": round(360 / found.direction_step_deg),
        "situations": len(found.situations),
        "others": sum(best != 0 for best in found.best),
        "walks": min((one.walks for one in found.situations), default=0),
        "bytes": Path(path).stat().st_size,
    }


def repertoire_files(folder: Path | str = "runs") -> list[Path]:
    """Files that may be repertoires, in the order of the search: those that were built, then shipped ones."""
    folders = [Path(folder) / REPERTOIRES, config_root() / REPERTOIRES]
    return [path for one in folders if one.is_dir() for path in sorted(one.glob(f"*{SUFFIX}"))]


def named_repertoire(text: str, folder: Path | str = "runs") -> Path:
    """Path of a repertoire: the path itself, or that of a file of this name among `repertoire_files`."""
    if Path(text).is_file():
        return Path(text)
    named = (path for path in repertoire_files(folder) if text in (path.name, path.stem))
    return next(named, Path(text))


def list_repertoires(
    folder: Path | str = "runs", *, on_damaged: Callable[[InputError], None] | None = None
) -> list[dict[str, Any]]:
    """Describe every repertoire that a walk would search, with its path as `repertoire`.

    Files that are not whole repertoires are left out, and reported to `on_damaged`.
    """
    described = []
    for path in repertoire_files(folder):
        try:
            described.append({"repertoire": str(path), **describe_repertoire(path)})
        except InputError as error:
            if on_damaged is not None:
                on_damaged(error)
    return described


def find_repertoire(robot: Robot, plan: TrialPlan, folder: Path | str = "runs") -> Repertoire | None:
    """The first repertoire that covers the walks of a plan; None without one.

    Files that cannot be read are passed over.
    """
    for path in repertoire_files(folder):
        try:
            found = _loaded(path, path.stat().st_mtime_ns)
        except (InputError, OSError):
            continue
        if found.covers(robot, plan):
            return found
    return None


@lru_cache(maxsize=8)
def _loaded(path: Path, _modified_ns: int) -> Repertoire:
    """Repertoire of a file, read once in a process while the file stays as it is."""
    return load_repertoire(path)
