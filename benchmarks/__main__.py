"""Run the benchmarks: `python -m benchmarks [--json] [--quick] [--save] [--only NAME] [--list]`.

The exit code says whether every benchmark ran, not whether bars hold: 1 if one crashed, 2 for bad options.
"""

import argparse
import json
import sys
import traceback
from collections.abc import Sequence

from benchmarks.catalogue import BENCHMARKS, chosen, wanted
from benchmarks.results import save_rows
from benchmarks.rows import Row
from benchmarks.scale import FULL, QUICK, Scale


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
        "--quick", action="store_true", help="a smoke test: everything runs, nothing is measured"
    )
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
    scale: Scale = QUICK if options.quick else FULL
    try:
        for row in BENCHMARKS[name](scale):
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
