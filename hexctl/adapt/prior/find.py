"""Find the prior that answers a session's question: given by path, made before, or shipped."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from hexctl.adapt.prior.prior import read_head
from hexctl.adapt.prior.question import Question
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


def find_prior(question: Question, folders: Iterable[Path]) -> Found:
    """Return the first prior in some folders that answers a question, or why none does.

    A file that cannot be read is passed over: it may be anything.
    """
    nearest: tuple[int, str] | None = None
    for path in prior_files(folders):
        try:
            differences = _question_of(path).differences(question)
        except InputError:
            continue
        if not differences:
            return Found(path)
        if nearest is None or len(differences) < nearest[0]:
            nearest = (len(differences), f"{path.name} is for {', '.join(differences)}")
    return Found(None, nearest[1] if nearest else "none has been built")


def check_prior(path: Path, question: Question) -> None:
    """Raise InputError unless the prior of a file answers a question."""
    differences = _question_of(path).differences(question)
    if differences:
        raise InputError(
            f"prior {path}: is for {', '.join(differences)}; allowed: a prior for the same trials"
        )


def _question_of(path: Path) -> Question:
    """Return the question of a prior's file; raises InputError for a file that is none."""
    try:
        return Question(**read_head(path)["question"])
    except (KeyError, TypeError) as error:
        raise InputError(
            f"prior {path}: it is damaged ({error}); allowed: a prior as it was built"
        ) from error


def prior_files(folders: Iterable[Path]) -> list[Path]:
    """Return the files in some folders that may be priors, in the order in which they are looked at."""
    return [path for folder in folders if folder.is_dir() for path in sorted(folder.glob(f"*{SUFFIX}"))]
