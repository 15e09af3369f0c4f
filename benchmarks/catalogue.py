"""All benchmarks by name, and the choice among them."""

from collections.abc import Callable, Iterator, Sequence

from benchmarks.adapt import adapt_rows
from benchmarks.batch import batch_rows
from benchmarks.bus import bus_rows
from benchmarks.cameras import camera_rows
from benchmarks.clock import clock_rows
from benchmarks.flood import flood_rows
from benchmarks.link import link_rows
from benchmarks.memory import memory_rows
from benchmarks.recording import recording_rows
from benchmarks.ros import ros_rows
from benchmarks.rows import Row
from benchmarks.scale import Scale
from benchmarks.see import see_rows
from benchmarks.single import single_rows
from benchmarks.startup import startup_rows
from benchmarks.study import study_rows
from benchmarks.tick import tick_rows
from benchmarks.view import view_rows

Benchmark = Callable[[Scale], Iterator[Row]]

#: Each benchmark; the names of its rows begin with its own.
BENCHMARKS: dict[str, Benchmark] = {
    "startup": startup_rows,
    "tick": tick_rows,
    "clock": clock_rows,
    "view": view_rows,
    "link": link_rows,
    "flood": flood_rows,
    "ros": ros_rows,
    "bus": bus_rows,
    "see": see_rows,
    "cameras": camera_rows,
    "single": single_rows,
    "recording": recording_rows,
    "memory": memory_rows,
    "batch": batch_rows,
    "adapt": adapt_rows,
    "study": study_rows,
}


def chosen(prefixes: Sequence[str]) -> dict[str, Benchmark]:
    """Return the benchmarks that have rows whose names begin with one of the prefixes; all without any."""
    if not prefixes:
        return BENCHMARKS
    return {
        name: benchmark
        for name, benchmark in BENCHMARKS.items()
        if any(name.startswith(prefix) or prefix.startswith(f"{name}.") for prefix in prefixes)
    }


def wanted(row: Row, prefixes: Sequence[str]) -> bool:
    """Return whether a row's name begins with one of the prefixes; True without any."""
    return not prefixes or any(row.name.startswith(prefix) for prefix in prefixes)
