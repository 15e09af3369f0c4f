"""The entry point: almost nothing, so that Ctrl-C is understood from the first moment on."""

import sys


def main() -> None:
    """Load the command line, run it, and exit with its code."""
    try:
        from hexctl.cli.main import exit_code

        code = exit_code()
    except KeyboardInterrupt:
        sys.stderr.write("hexctl: ended at once\n")
        code = 130
    sys.exit(code)
