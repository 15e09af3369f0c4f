"""The table of what was searched, from the log of `python -m tests.fuzz --log`."""

import json
from collections import defaultdict
from pathlib import Path


def table(log: Path) -> str:
    """Markdown: a row for each target with all of its runs, and their sum."""
    runs = defaultdict(list)
    for line in log.read_text(encoding="utf-8").splitlines():
        run = json.loads(line)
        runs[run["target"]].append(run)
    rows = [
        "| Decoder | Inputs | Inputs/s | Branches |",
        "| --- | ---: | ---: | ---: |",
    ]
    for name, each in runs.items():
        inputs, seconds = sum(run["inputs"] for run in each), sum(run["seconds"] for run in each)
        branches = max(run["branches"] for run in each)
        rows.append(f"| {name} | {inputs:,} | {inputs / max(seconds, 0.1):,.0f} | {branches:,} |")
    total = sum(run["inputs"] for each in runs.values() for run in each)
    return "\n".join([*rows, f"| all {len(runs)} | {total:,} | | |"])
