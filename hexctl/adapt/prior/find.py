"""Find the prior that answers a session's question: given by path, made before, or shipped."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from hexctl.adapt.prior.prior import PriorKey, read_head
from hexctl.errors import InputError
from hexctl.robot.configs import config_root

SUFFIX = ".npz"


@dataclass(frozen=True)
class Found:
    """What the search for a prior came to.

    Attributes:
        path: of the prior, or None.
        reason: why there is none, for people; empty when there is one.
    """

    path: Path | None
    reason: str = ""


def shipped_priors() -> Path:
    """Return the folder of the priors that come with hexctl."""
    return config_root() / "priors"


def named_prior(text: str, folders: Iterable[Path]) -> Path:
    """Return the path of a prior, or of one in some folders by the name of its file."""
    path = Path(text)
    if path.exists() or path.name != text:
        return path
    name = text if path.suffix == SUFFIX else f"{text}{SUFFIX}"
    return next((found for found in prior_files(folders) if found.name == name), path)


Serves = Callable[[tuple[int, ...]], bool]


def any_legs(_legs: tuple[int, ...]) -> bool:
    """Return True: the legs of a prior do not matter."""
    return True


def find_prior(question: PriorKey, folders: Iterable[Path], *, serves: Serves = any_legs) -> Found:
    """Return the first prior in some folders that answers a question, or why none does.

    `serves` is asked whether a prior of some legs says anything about those that matter. A file that cannot
    be read is passed over: it may be anything.
    """
    nearest: tuple[int, str] | None = None
    for path in prior_files(folders):
        try:
            differences = _differences(path, question, serves)
        except InputError:
            continue
        if not differences:
            return Found(path)
        if nearest is None or len(differences) < nearest[0]:
            nearest = (len(differences), f"{path.name} is for {', '.join(differences)}")
    return Found(None, nearest[1] if nearest else "none has been built")


def check_prior(path: Path, question: PriorKey, *, serves: Serves = any_legs) -> None:
    """Raise InputError unless the prior of a file answers a question."""
    differences = _differences(path, question, serves)
    if differences:
        raise InputError(
            f"prior {path}: is for {', '.join(differences)}; allowed: a prior for the same trials"
        )


def _differences(path: Path, question: PriorKey, serves: Serves) -> list[str]:
    """Return in what a prior's file differs from what is asked; raises InputError for a file that is none."""
    head = read_head(path)
    try:
        differences = PriorKey(**head["question"]).differences(question)
        legs = tuple(int(leg) for leg in head["legs"])
        if not serves(legs):
            differences.append(f"failed leg {', '.join(str(leg) for leg in legs)}")
        return differences
    except (KeyError, TypeError) as error:
        raise InputError(
            f"prior {path}: it is damaged ({error}); allowed: a prior as it was built"
        ) from error


def prior_files(folders: Iterable[Path]) -> list[Path]:
    """Return the files in some folders that may be priors, in the order in which they are looked at."""
    return [path for folder in folders if folder.is_dir() for path in sorted(folder.glob(f"*{SUFFIX}"))]
