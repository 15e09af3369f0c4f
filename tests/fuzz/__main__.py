"""Search all decoders, or some: `python -m tests.fuzz --inputs 100000 [TARGET ...]`. It needs atheris."""

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz.corpus import keep, keep_found, kept, reaching
from tests.fuzz.rooms import ROOMS, targets_of
from tests.fuzz.target import Target

_STAT = re.compile(r"stat::(\w+):\s*(\d+)")
_COVERAGE = re.compile(r"cov: (\d+)")


def main() -> int:
    """Search, print a line for each target, and return 1 where one fell."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", help="names of targets or of rooms (default: all)")
    parser.add_argument("--inputs", type=int, default=100_000, help="inputs for each (default: 100000)")
    parser.add_argument("--seconds", type=int, default=0, help="time for each, 0 for any (default: 0)")
    parser.add_argument("--seed", type=int, default=0, help="of the mutations, 0 for any (default: 0)")
    parser.add_argument("--keep", action="store_true", help="keep what reached something new, or fell")
    wanted = parser.parse_args()
    chosen = [(room, target) for room in ROOMS for target in targets_of(room)]
    known = {*ROOMS, *(target.name for _, target in chosen)}
    if unknown := set(wanted.targets) - known:
        parser.error(f"got {', '.join(sorted(unknown))}; allowed: {', '.join(sorted(known))}")
    fell = 0
    for room, target in chosen:
        if not wanted.targets or {room, target.name} & set(wanted.targets):
            fell += _search(room, target, wanted)
    return 1 if fell else 0


def _search(room: str, target: Target, wanted: argparse.Namespace) -> int:
    """Search one target in a process of its own, and print how it went; how many defects were found."""
    name = target.name
    with tempfile.TemporaryDirectory(prefix="hexctl-fuzz-") as place:
        folder = Path(place)
        flags = [f"-runs={wanted.inputs}", f"-seed={wanted.seed}", "-print_final_stats=1", "-timeout=60"]
        if wanted.seconds:
            flags.append(f"-max_total_time={wanted.seconds}")
        command = [sys.executable, "-m", "tests.fuzz.engine", room, name, str(folder), *flags]
        began_s = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        stats = dict(_STAT.findall(done.stderr))
        falls = sorted(folder.glob(f"{name}-*.txt"))
        if done.returncode or "number_of_executed_units" not in stats:
            print(done.stderr[-2000:], file=sys.stderr)
        inputs = int(stats.get("number_of_executed_units", 0))
        branches = int((_COVERAGE.findall(done.stderr) or ["0"])[-1])
        taken_s = time.monotonic() - began_s
        fell = len(falls) + (done.returncode != 0)
        print(f"{name:16} {inputs:>10} inputs, {taken_s:>6.1f} s, {branches:>5} branches, {fell} fell")
        for fall in falls:
            print(f"  {fall.with_suffix('.bin').read_bytes()[:200]!r}\n  {fall.read_text()}")
        sys.stdout.flush()
        if wanted.keep:
            reached = [path.read_bytes() for path in (folder / "corpus").glob("*")]
            keep(room, name, reaching(target, {*kept(name), *reached}))
            ended = [path for kind in ("crash", "timeout", "oom") for path in folder.glob(f"{kind}-*")]
            keep_found(name, [path.read_bytes() for path in (*folder.glob(f"{name}-*.bin"), *ended)])
    return fell


if __name__ == "__main__":
    sys.exit(main())
