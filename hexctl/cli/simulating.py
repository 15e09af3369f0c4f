"""What commands share that simulate for minutes or hours: where, on what, and how they are stopped."""

import signal
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from types import FrameType

from hexctl.cli.console import RUNS, SIGNALS, print_note
from hexctl.cli.studyprogress import StudyProgress
from hexctl.errors import InputError
from hexctl.study.cache import LandscapeCache
from hexctl.study.evaluate import Simulate, fill, simulate_here
from hexctl.study.landscape import Landscape, LandscapeSpec

CACHE = RUNS / "study-cache"
MAX_JOBS = 1024


def listed(text: str) -> tuple[str, ...]:
    """Return the parts of a text between commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def listed_legs(text: str) -> tuple[int, ...]:
    """Return the legs of a text such as `2,5`, ascending; raises InputError for anything but numbers."""
    try:
        return tuple(sorted(int(part) for part in listed(text)))
    except ValueError:
        raise InputError(f"--legs: got {text!r}; allowed: numbers 1..6 with commas, such as 2,5") from None


def check_jobs(jobs: int | None) -> None:
    """Raise InputError for a number of threads that no machine has."""
    if jobs is not None and not 1 <= jobs <= MAX_JOBS:
        raise InputError(f"--jobs: got {jobs}; allowed: 1..{MAX_JOBS}")


def open_cache() -> LandscapeCache:
    """Return the cache of all commands; raises CacheError at once where it cannot be written."""
    cache = LandscapeCache(CACHE)
    cache.probe()
    return cache


def walked(
    specs: Sequence[LandscapeSpec],
    cache: LandscapeCache,
    progress: StudyProgress,
    *,
    jobs: int | None,
    dask: str | None,
) -> list[Landscape]:
    """Return the landscapes of some specs, what the cache lacks simulated, and tell what was wrong in it."""
    with ExitStack() as stack:
        landscapes = fill(specs, cache, _simulate_with(jobs, dask, stack), progress)
    for note in cache.notes:
        progress.note(note)
    return landscapes


def _simulate_with(jobs: int | None, dask: str | None, stack: ExitStack) -> Simulate:
    """Return the way to simulate: on the workers of a cluster until the stack ends, or here."""
    if dask is None:
        return simulate_here(jobs or 0)
    from hexctl.study.evaluate import dask_executor, simulate_on

    return simulate_on(stack.enter_context(dask_executor(dask)), jobs or 1)


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Take SIGTERM for Ctrl-C meanwhile, and Ctrl-C for itself even where a shell has switched it off."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def say_interrupted(specs: Sequence[LandscapeSpec], cache: LandscapeCache) -> None:
    """Tell on stderr what is saved and how to go on."""
    landscapes = [cache.load(spec) for spec in specs]
    done = sum(int(landscape.done.sum()) for landscape in landscapes)
    total = sum(len(landscape.codes) for landscape in landscapes)
    print_note(f"interrupted: {done} of {total} gaits are saved in {cache.folder}; the same command goes on")
