"""Find, list and describe the priors of sessions: by path, custom or shipped."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hexctl.adapt.prior.prior import KIND, SCORES, PriorKey, ScorePrior, open_prior
from hexctl.adapt.prior.samples import covers
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.files import OnDamage, log_damage
from hexctl.robot.configs import config_root
from hexctl.robot.model import Robot

SUFFIX = ".npz"

#: Folder of the priors that were built, in the folder of sessions and recordings.
PRIORS = "priors"


@dataclass(frozen=True)
class PriorMatch:
    """Path of a prior, or the reason why there is none."""

    path: Path | None
    reason: str = ""


def shipped_priors() -> Path:
    """Folder of the shipped priors."""
    return config_root() / "priors"


def prior_folders(folder: Path) -> list[Path]:
    """Folders of priors in the order of search: custom ones below a folder come first."""
    return [folder / PRIORS, shipped_priors()]


def named_prior(text: str, folders: Iterable[Path]) -> Path:
    """Path of a prior: the text itself, or a file of this name in some folders."""
    path = Path(text)
    if path.exists() or path.name != text:
        return path
    name = text if path.suffix == SUFFIX else f"{text}{SUFFIX}"
    return next((found for found in prior_files(folders) if found.name == name), path)


def find_prior(
    robot: Robot, plan: TrialPlan, folders: Iterable[Path], *, any_duration: bool = False
) -> PriorMatch:
    """Find the first prior in some folders for the trials of a plan, or why there is none.

    `any_duration` allows other durations, if only the order of the gaits counts. Damaged files are skipped.
    """
    nearest: tuple[int, str] | None = None
    for path in prior_files(folders):
        try:
            differences = _differences(path, robot, plan, any_duration=any_duration)
        except InputError:
            continue
        if not differences:
            return PriorMatch(path)
        if nearest is None or len(differences) < nearest[0]:
            nearest = (len(differences), f"{path.name} is for {', '.join(differences)}")
    return PriorMatch(None, nearest[1] if nearest else "none has been built")


def check_prior(path: Path, robot: Robot, plan: TrialPlan) -> None:
    """Raise InputError unless the prior of a file is for the trials of a plan."""
    differences = _differences(path, robot, plan)
    if differences:
        raise InputError(
            f"prior {path}: is for {', '.join(differences)}; allowed: a prior for the same trials"
        )


def _differences(path: Path, robot: Robot, plan: TrialPlan, *, any_duration: bool = False) -> list[str]:
    head, key = KIND.read_head(path), PriorKey.of(robot, plan)
    try:
        own, legs = PriorKey(**head["question"]), tuple(int(leg) for leg in head["legs"])
        differences = own.differences(replace(key, duration_s=own.duration_s) if any_duration else key)
        if not covers(robot, plan.self_rotation, legs, plan.failed_legs[0]):
            differences.append(f"failed leg {', '.join(str(leg) for leg in legs)}")
        return differences
    except (KeyError, TypeError) as error:
        raise InputError(
            f"prior {path}: it is damaged ({error}); allowed: a prior as it was built"
        ) from error


def prior_files(folders: Iterable[Path]) -> list[Path]:
    """Possible prior files in some folders, in the order of search."""
    return [path for folder in folders if folder.is_dir() for path in sorted(folder.glob(f"*{SUFFIX}"))]


def describe_prior(path: Path) -> dict[str, Any]:
    """Key and content of a prior, as JSON values; raises InputError for a damaged file."""
    prior = open_prior(path)
    if isinstance(prior, ScorePrior):
        kind: dict[str, Any] = {"scores": list(SCORES)}
    else:
        kind = {"stances": prior.sag_rad is not None}
    return {
        **prior.key.as_json(),
        "legs": list(prior.legs),
        **kind,
        "worlds": prior.worlds,
        "bytes": path.stat().st_size,
    }


def list_priors(folder: Path | str = "runs", *, on_damage: OnDamage = log_damage) -> list[dict[str, Any]]:
    """Describe the priors that `hexctl adapt` searches, with paths as `prior`, without damaged ones."""
    return KIND.described(prior_files(prior_folders(Path(folder))), describe_prior, on_damage)
