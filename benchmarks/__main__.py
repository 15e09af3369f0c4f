"""Run the benchmarks: `python -m benchmarks [--json] [--quick] [--only NAME] [--list]`.

The exit code says whether every benchmark ran, not whether bars hold: 1 if one crashed, 2 for bad options.
"""

import argparse
import json
import sys
import traceback
from collections.abc import Sequence

from benchmarks.catalogue import BENCHMARKS, chosen, wanted
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
    crashed = [name for name in selected if not _run(name, options.only, options.json, options.quick)]
    return 1 if crashed else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object per row instead of a table")
    parser.add_argument(
        "--quick", action="store_true", help="a smoke test: everything runs, nothing is measured"
    )
    parser.add_argument(
        "--only", action="append", default=[], metavar="NAME", help="rows whose names begin so; repeatable"
    )
    parser.add_argument("--list", action="store_true", help="print the names and run nothing")
    return parser


def _run(name: str, prefixes: Sequence[str], as_json: bool, quick: bool) -> bool:
    """Run one benchmark and print its rows; return False, with the traceback on stderr, if it crashed."""
    scale: Scale = QUICK if quick else FULL
    try:
        for row in BENCHMARKS[name](scale):
            if wanted(row, prefixes):
                print(json.dumps(row.as_json()) if as_json else row, flush=True)
    except Exception:  # noqa: BLE001  one benchmark that crashes must not keep the others from running
        print(f"benchmark {name} crashed:", file=sys.stderr)
        traceback.print_exc()
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
