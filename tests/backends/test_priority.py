"""Realtime priority is for the control loop alone."""

import subprocess
import sys

import pytest

CHILDREN = """
import os, subprocess, sys
from hexctl.backends.clock import request_realtime_priority

if not request_realtime_priority():
    sys.exit("not permitted")
ask = "import os; print(os.sched_getscheduler(0) == os.SCHED_FIFO)"
print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO, flush=True)
subprocess.run([sys.executable, "-c", ask], check=True)
child = os.fork()
if not child:
    print(os.sched_getscheduler(0) == os.SCHED_FIFO, flush=True)
    os._exit(0)
os.waitpid(child, 0)
"""


@pytest.mark.skipif(not hasattr(__import__("os"), "SCHED_RESET_ON_FORK"), reason="Linux only")
def test_what_is_started_from_the_loop_does_not_inherit_its_priority() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CHILDREN], capture_output=True, text=True, timeout=120, check=False
    )
    if "not permitted" in done.stderr:
        pytest.skip("realtime priority is not permitted here")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True", "False", "False"]
