"""The command as its own process, in an empty folder."""

import json
import subprocess
import sys
import tempfile
import time
from typing import Any


def timed_hexctl(*arguments: str) -> tuple[float, Any]:
    """Run hexctl with --json; return its wall time in s and what it printed.

    Raises RuntimeError when it fails.
    """
    command = [sys.executable, "-m", "hexctl", *arguments, "--json"]
    with tempfile.TemporaryDirectory() as folder:
        began_s = time.perf_counter()
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        wall_s = time.perf_counter() - began_s
    if done.returncode:
        raise RuntimeError(f"hexctl {arguments[0]} failed: {done.stderr.strip()}")
    return wall_s, json.loads(done.stdout)
