"""Search all decoders, or some: `python -m tests.fuzz --inputs 100000 [TARGET ...]`. It needs atheris."""

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.fuzz.corpus import keep
from tests.fuzz.rooms import ROOMS, targets_of

_STAT = re.compile(r"stat::(\w+):\s*(\d+)")
_COVERAGE = re.compile(r"cov: (\d+)")


def main() -> int:
    """Search, print a line for each target, and return 1 where one fell."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", help="names of targets (default: all)")
    parser.add_argument("--inputs", type=int, default=100_000, help="inputs for each (default: 100000)")
    parser.add_argument("--seconds", type=int, default=0, help="time for each, 0 for any (default: 0)")
    parser.add_argument("--seed", type=int, default=0, help="of the mutations, 0 for any (default: 0)")
    parser.add_argument("--keep", action="store_true", help="keep what reached something new in the corpus")
    wanted = parser.parse_args()
    chosen = [(room, target.name) for room in ROOMS for target in targets_of(room)]
    if unknown := set(wanted.targets) - {name for _, name in chosen}:
        parser.error(f"got {', '.join(sorted(unknown))}; allowed: {', '.join(name for _, name in chosen)}")
    fell = 0
    for room, name in chosen:
        if not wanted.targets or name in wanted.targets:
            fell += _search(room, name, wanted)
    return 1 if fell else 0


def _search(room: str, name: str, wanted: argparse.Namespace) -> int:
    """Search one target in a process of its own, and print how it went; how many defects were found."""
    with tempfile.TemporaryDirectory(prefix="hexctl-fuzz-") as place:
        folder = Path(place)
        flags = [f"-runs={wanted.inputs}", f"-seed={wanted.seed}", "-print_final_stats=1", "-timeout=60"]
        if wanted.seconds:
            flags.append(f"-max_total_time={wanted.seconds}")
        command = [sys.executable, "-m", "tests.fuzz.engine", room, name, str(folder), *flags]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        stats = dict(_STAT.findall(done.stderr))
        if "number_of_executed_units" not in stats:
            print(done.stderr[-2000:], file=sys.stderr)
        coverage = _COVERAGE.findall(done.stderr)
        falls = sorted(folder.glob(f"{name}-*.txt"))
        corpus = [path.read_bytes() for path in (folder / "corpus").glob("*")]
        _print(name, stats, coverage[-1] if coverage else "?", len(corpus), falls)
        if wanted.keep:
            keep(name, corpus)
    return len(falls) + (done.returncode != 0)


def _print(name: str, stats: dict[str, str], coverage: str, corpus: int, falls: list[Path]) -> None:
    inputs, per_s = stats.get("number_of_executed_units", "?"), stats.get("average_exec_per_sec", "?")
    print(
        f"{name:16} {inputs:>10} inputs, {per_s:>6}/s, {coverage:>5} branches, {corpus:>5} kept, "
        f"{len(falls)} fell",
        flush=True,
    )
    for fall in falls:
        data = fall.with_suffix(".bin").read_bytes()
        print(f"  {data[:200]!r}\n  {fall.read_text()}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
