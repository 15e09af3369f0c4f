"""MuJoCo reads an MJCF in a child process, with limits of memory and time, because it has none itself."""

import math
import os
import pickle
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from hexctl.errors import InputError, MissingExtraError
from hexctl.robot.formats.importing.link_tree import LinkTree
from hexctl.robot.formats.importing.mjcf_files import check_mjcf_files

#: Memory and processor time of the child after its imports, and the time until it must have answered.
MOST_MB, MOST_CPU_S, TIMEOUT_S = 360, 2, 20.0

#: The child draws nothing, and its matrices are small.
_ENVIRONMENT = {"MUJOCO_GL": "disable", "OPENBLAS_NUM_THREADS": "1"}


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
    try:
        done = subprocess.run(
            # -P: no file in the working folder replaces a module.
            [sys.executable, "-P", "-m", __name__, str(path)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the parent, which ends the child
            env={**os.environ, **_ENVIRONMENT},
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "refused", f"MuJoCo did not compile it in {TIMEOUT_S:g} s"
    if done.returncode:
        return "refused", f"MuJoCo failed, or needed more than {MOST_CPU_S} s or {MOST_MB} MB"
    return pickle.loads(done.stdout)  # type: ignore[no-any-return]  # noqa: S301  of our own child


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    cpu_s = math.ceil(time.process_time()) + MOST_CPU_S
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
    data = MOST_MB * 1_000_000
    resource.setrlimit(resource.RLIMIT_DATA, (data, data))


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
