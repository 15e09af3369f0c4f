"""Run the benchmarks: `python -m benchmarks [--json] [--save] [--only NAME] [--list]`.

The exit code says whether every benchmark ran, not whether bars hold: 1 if one crashed, 2 for bad options.
"""

import argparse
import json
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence

from benchmarks.adapt import adapt_rows
from benchmarks.batch import batch_rows
from benchmarks.bus import bus_rows
from benchmarks.cameras import camera_rows
from benchmarks.check import check_rows
from benchmarks.clock import clock_rows
from benchmarks.flood import flood_rows
from benchmarks.link import link_rows
from benchmarks.memory import memory_rows
from benchmarks.recording import recording_rows
from benchmarks.results import save_rows
from benchmarks.ros import ros_rows
from benchmarks.rows import Row
from benchmarks.scale import FULL, Scale
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
    "check": check_rows,
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what was asked for, print each row as soon as it is known, and return the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.list:
        print("\n".join(BENCHMARKS))
        return 0
    selected = chosen(options.only)
    if not selected:
        parser.error(f"--only: got {', '.join(options.only)}; allowed: beginnings of {', '.join(BENCHMARKS)}")
    rows = list[Row]()
    crashed = [name for name in selected if not _run(name, options, rows)]
    if options.save:
        save_rows(rows)
    return 1 if crashed else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object per row instead of a table")
    parser.add_argument(
        "--save", action="store_true", help="write the rows into docs/results/results.yaml and the pages"
    )
    parser.add_argument(
        "--only", action="append", default=[], metavar="NAME", help="rows whose names begin so; repeatable"
    )
    parser.add_argument("--list", action="store_true", help="print the names and run nothing")
    return parser


def _run(name: str, options: argparse.Namespace, rows: list[Row]) -> bool:
    """Run one benchmark, print and collect its rows; return False, and print the traceback, if it crashed."""
    try:
        for row in BENCHMARKS[name](FULL):
            if wanted(row, options.only):
                rows.append(row)
                print(json.dumps(row.as_json()) if options.json else row, flush=True)
    except Exception:  # noqa: BLE001  one benchmark that crashes must not keep the others from running
        print(f"benchmark {name} crashed:", file=sys.stderr)
        traceback.print_exc()
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
