"""Run the fault matrix: `python -m faults [--only FAULT/BACKEND/PHASE] [--repetitions N]`, `make faults`.

What is measured is added to a file, line by line; a run that ends early goes on where it was.
"""

import argparse
import json
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from faults.backend import BACKENDS
from faults.fault import FAULTS
from faults.matrix import Matrix, jobs
from faults.measurement import Outcome
from faults.phase import PHASES
from faults.results import RESULTS, Results

#: Names of faults, backends and phases.
NAMES: tuple[list[str], ...] = (list(FAULTS), list(BACKENDS), list(PHASES))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing, print it, and return the exit code.

    1 where an injection ended with an error of the matrix itself, 2 for bad options, 130 where ended early.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    results = Results(options.results)
    if options.table:
        from faults.table import page_part

        print(page_part(results.read(), results.not_measured()))
        return 0
    if options.figure is not None:
        from faults.figure import draw

        draw(results.read(), options.figure)
        return 0
    _check(parser, options.only)
    work = jobs(options.only, options.repetitions, results.read())
    if options.list:
        for job in work:
            print(f"{job.fault}/{job.backend}: {len(job.wanted)} to run")
        return 0

    def say(outcome: Outcome | str) -> None:
        if isinstance(outcome, str):
            print(outcome, file=sys.stderr, flush=True)
        else:
            print(json.dumps(outcome.as_json()) if options.json else _line(outcome), flush=True)

    for number in (signal.SIGINT, signal.SIGTERM):  # also in the background, where a shell ignores the first
        signal.signal(number, signal.default_int_handler)
    matrix = Matrix(results, say)
    try:
        matrix.run(work, options.rigs)
    except KeyboardInterrupt:
        print("ended; what was measured is kept, and the same command goes on", file=sys.stderr)
        return 130
    return 1 if matrix.broken else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m faults", description=__doc__)
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="FAULT/BACKEND/PHASE",
        help="cells to run, * for any, what is left out is any; repeatable (default: all)",
    )
    parser.add_argument("--repetitions", type=_count, default=3, help="of each cell, 1 or more (default: 3)")
    parser.add_argument("--rigs", type=_count, default=2, help="robots at a time, 1 or more (default: 2)")
    parser.add_argument(
        "--results", type=Path, default=RESULTS, help=f"file to which outcomes are added (default: {RESULTS})"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per injection")
    parser.add_argument("--list", action="store_true", help="print what is left to run, and run nothing")
    parser.add_argument("--table", action="store_true", help="print the tables of the results, run nothing")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the results, run nothing")
    return parser


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"got {text}; allowed: 1 or more")
    return value


def _check(parser: argparse.ArgumentParser, patterns: Sequence[str]) -> None:
    for pattern in patterns:
        for part, known in zip(pattern.split("/"), NAMES, strict=False):
            if part not in ("*", "", *known):
                parser.error(f"--only: got {part}; allowed: {', '.join(known)} or *")


def _line(outcome: Outcome) -> str:
    """An outcome as a line."""
    rest = "moves on" if outcome.rest_s is None else f"rest {outcome.rest_s:.3f} s"
    parts = [rest, f"told {outcome.told_s:.3f} s", f"step {outcome.step:.2f}"]
    parts += ["FELL"] if outcome.fell else []
    parts += [f"stopped: {', '.join(outcome.stops)}"] if outcome.stops else []
    parts += [f"ended: {outcome.ended}"] if outcome.ended else []
    parts += [f"{outcome.trials} trials, {outcome.lost} lost"] if outcome.trials is not None else []
    parts += ["UNNEEDED"] if outcome.unneeded else []
    late_s = max(outcome.late_s, outcome.waited_s)
    parts += [f"late {late_s:.3f} s"] if not outcome.punctual else []
    name = f"{outcome.fault}/{outcome.backend}/{outcome.phase} {outcome.repetition}"
    return f"{name:<48} {', '.join(parts)}"


if __name__ == "__main__":
    sys.exit(main())
