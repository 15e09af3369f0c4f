"""Repertoires on disk, custom and shipped: save, check, load and find."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from hexctl.archive import ArchiveKind
from hexctl.control.body_symmetry import BodySymmetry
from hexctl.control.monitor.repertoire import PLAIN, Candidate, Repertoire, Situation
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.files import OnDamage, log_damage
from hexctl.robot.configs import config_root
from hexctl.robot.model import Robot

VERSION = 1

KIND = ArchiveKind(name="repertoire", versions=(VERSION,), command="hexctl prior build --repertoire")

SUFFIX = ".npz"

#: Folder of custom repertoires in the folder of sessions, and of shipped ones.
REPERTOIRES = "repertoires"


def save_repertoire(repertoire: Repertoire, path: Path) -> None:
    """Write a repertoire atomically; raises ArchiveFileError when the disk refuses."""
    KIND.save(path, VERSION, repertoire.head, repertoire.arrays)


def load_repertoire(path: Path | str) -> Repertoire:
    """Repertoire of a file; raises InputError for a wrong, damaged or altered file, or another version."""
    return KIND.load(path, _made)


def _made(head: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Repertoire:
    candidates_of = TypeAdapter(tuple[Candidate, ...]).validate_python
    shapes = [(len(one["candidates"]), int(one["walks"])) for one in head["situations"]]
    ends = np.cumsum([candidates * walks for candidates, walks in shapes], dtype=int)[:-1]
    speeds, costs = (np.split(arrays[name].astype(float), ends) for name in ("speeds", "costs"))
    situations = [
        Situation(
            failed=tuple((leg, kind, joint) for leg, kind, joint in values["failed"]),
            heading_deg=values["heading_deg"],
            candidates=candidates_of(values["candidates"]),
            speeds=speed.reshape(shape),
            costs=cost.reshape(shape),
        )
        for values, shape, speed, cost in zip(head["situations"], shapes, speeds, costs, strict=False)
    ]
    symmetries = TypeAdapter(tuple[BodySymmetry, ...]).validate_python(head["symmetries"])
    plain = {name: head[name] for name in (*PLAIN, "origin")}
    return Repertoire(**plain, symmetries=symmetries, situations=tuple(situations))


def describe_repertoire(path: Path | str) -> dict[str, Any]:
    """Summary of a repertoire as JSON values; raises InputError as `load_repertoire` does."""
    found = load_repertoire(path)
    kinds = [(len(one.failed), *one.failed[0][1:]) for one in found.situations]
    words = {
        count: [f"{kind}:{joint}" if joint else kind for n, kind, joint in kinds if n == count]
        for count in (1, 2)
    }
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
    """Candidate files in the order of the search: custom ones, then shipped ones."""
    folders = [Path(folder) / REPERTOIRES, config_root() / REPERTOIRES]
    return [path for one in folders if one.is_dir() for path in sorted(one.glob(f"*{SUFFIX}"))]


def named_repertoire(text: str, folder: Path | str = "runs") -> Path:
    """Path of a repertoire: the path itself, or that of a file of this name among `repertoire_files`."""
    if Path(text).is_file():
        return Path(text)
    named = (path for path in repertoire_files(folder) if text in (path.name, path.stem))
    return next(named, Path(text))


def list_repertoires(
    folder: Path | str = "runs", *, on_damage: OnDamage = log_damage
) -> list[dict[str, Any]]:
    """Describe the repertoires of a walk's search, with paths as `repertoire`, without damaged ones."""
    return KIND.described(repertoire_files(folder), describe_repertoire, on_damage)


def find_repertoire(robot: Robot, plan: TrialPlan, folder: Path | str = "runs") -> Repertoire | None:
    """The first readable repertoire that covers the walks of a plan, or None."""
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
    return load_repertoire(path)
