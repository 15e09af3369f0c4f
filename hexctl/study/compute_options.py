"""Options that say on what studies and priors are simulated."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hexctl.options import RARE, Range

JOBS = Range(low=1, high=1024, whole=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class ComputeOptions:
    """On what studies and priors are simulated."""

    PANEL: ClassVar = "Computer"

    jobs: Annotated[int | None, JOBS, RARE] = None
    """Threads that simulate, {}. (default: all cores; with --dask 1)"""

    dask: Annotated[str | None, RARE] = None
    """Address of a Dask scheduler whose workers simulate: tcp://HOST:PORT. (default: this computer)"""
