"""MuJoCo reads an MJCF in a child process, with limits of memory and time, because it has none itself."""

import math
import os
import pickle
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from hexctl.errors import InputError, MissingExtraError
from hexctl.robot.formats.importing.link_tree import LinkTree
from hexctl.robot.formats.importing.mjcf_files import check_mjcf_files

#: Memory of the child, its processor time and wall time after its imports, and the wall time from its start.
MOST_MB, MOST_CPU_S, MOST_S, TIMEOUT_S = 360, 3, 10.0, 20.0

#: The child draws nothing, and its matrices are small.
_ENVIRONMENT = {"MUJOCO_GL": "disable", "OPENBLAS_NUM_THREADS": "1"}

#: Folder of this package, which the parent may know only by its current folder.
_ROOT = str(Path(__file__).parents[4])


def read_mjcf(path: Path) -> LinkTree:
    """Tree of an MJCF file; raises InputError for no valid MJCF, MissingExtraError without MuJoCo."""
    try:
        check_mjcf_files(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {error}; allowed: an MJCF of a robot") from error
    kind, content = _answer(path)
    if kind == "missing":
        raise MissingExtraError("importing an MJCF", "sim")
    if kind == "refused":
        raise InputError(f"{path}: {content}; allowed: a valid MJCF")
    return content  # type: ignore[no-any-return]


def _answer(path: Path) -> tuple[str, Any]:
    paths = [*filter(None, sys.path), _ROOT]
    try:
        done = subprocess.run(
            # -P: no file in the working folder replaces a module.
            [sys.executable, "-P", "-m", __name__, str(path)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            start_new_session=True,  # Ctrl-C is for the parent, which ends the child
            env={**os.environ, **_ENVIRONMENT, "PYTHONPATH": os.pathsep.join(paths)},
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "refused", f"MuJoCo did not compile it in {TIMEOUT_S:g} s"
    if done.returncode:
        return "refused", _failure(-done.returncode, done.stderr.decode("utf-8", "replace"))
    return pickle.loads(done.stdout)  # type: ignore[no-any-return]  # noqa: S301  of our own child


def _failure(ended_by: int, printed: str) -> str:
    """Why the child failed, from its signal and its last words."""
    if ended_by == signal.SIGALRM:
        return f"MuJoCo did not compile it in {MOST_S:g} s"
    last = (printed.splitlines() or [""])[-1].strip()
    if ended_by in (signal.SIGXCPU, signal.SIGKILL) or re.search("MemoryError|bad_alloc", last):
        return f"MuJoCo needs more than {MOST_CPU_S} s or {MOST_MB} MB for it"
    return f"MuJoCo failed ({last or f'status {-ended_by}'})"


def _limit() -> None:
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # the command ignores it
    signal.setitimer(signal.ITIMER_REAL, MOST_S)  # also ends a child that has lost its parent
    _limit_one(resource.RLIMIT_CORE, 0)
    _limit_one(resource.RLIMIT_CPU, math.ceil(time.process_time()) + MOST_CPU_S)
    _limit_one(resource.RLIMIT_DATA, MOST_MB * 1_000_000)


def _limit_one(kind: int, most: int) -> None:
    _, hard = resource.getrlimit(kind)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(kind, (most, most))


def answer_here(path: Path, *, limited: bool = False) -> tuple[str, Any]:
    """`tree` and the tree, `refused` and the reason, or `missing` without MuJoCo, by this process."""
    try:
        from hexctl.robot.formats.importing.mjcf_tree import compiled_tree
    except ModuleNotFoundError:
        return "missing", ""
    if limited:
        _limit()
    try:
        return "tree", compiled_tree(path)
    except (MemoryError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        short = isinstance(error, MemoryError) or "allocate memory" in reason or "unknown exception" in reason
        return "refused", f"MuJoCo needs more than {MOST_MB} MB for it" if short else reason


def _main(path: str) -> None:
    """Write the answer to the standard output."""
    answer = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # MuJoCo may print
    pickle.dump(answer_here(Path(path), limited=True), answer)
    answer.flush()
    os._exit(0)


if __name__ == "__main__":
    _main(sys.argv[1])
