"""The entry point; it imports almost nothing before it handles Ctrl-C."""

import os
import sys


def main() -> None:
    """Load the command line, run it, and exit with its code."""
    # Matrices are small here: threads of the linear algebra wait for one another longer than they work, and
    # take the cores from the simulation and the 50 Hz loop. Read when NumPy and SciPy are imported.
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    try:
        from hexctl.cli.main import exit_code

        code = exit_code()
    except KeyboardInterrupt:
        sys.stderr.write("hexctl: interrupted\n")
        code = 130
    sys.exit(code)
