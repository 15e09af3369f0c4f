"""How long the command line takes to answer, as a process."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale


def startup_rows(scale: Scale) -> Iterator[Row]:
    """Wall time of `hexctl --help` and of a Tab, from the start of the process to its end."""
    hexctl = Path(sys.executable).with_name("hexctl")
    help_s = _median_wall_s([str(hexctl), "--help"], scale.starts)
    tab = {"_HEXCTL_COMPLETE": "complete_bash", "COMP_WORDS": "hexctl adapt --optimizer d", "COMP_CWORD": "3"}
    tab_s = _median_wall_s([str(hexctl)], scale.starts, **tab)
    python_s = _median_wall_s([sys.executable, "-c", "pass"], scale.starts)
    yield Row("startup.help", help_s, "s", Bar(high=0.35), f"median of {scale.starts}")
    yield Row("startup.completion", tab_s, "s", Bar(high=0.5), "a Tab after --optimizer, the slowest")
    yield Row("startup.python", python_s, "s", None, "the interpreter alone")


def _median_wall_s(command: list[str], times: int, **variables: str) -> float:
    """Return the median wall time of a command, after one run that warms the disk's cache."""
    _wall_s(command, variables)
    return median(_wall_s(command, variables) for _ in range(times))


def _wall_s(command: list[str], variables: dict[str, str]) -> float:
    began_s = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=os.environ | variables)
    return time.perf_counter() - began_s
