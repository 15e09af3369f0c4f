"""The entry point; it imports almost nothing before it handles Ctrl-C."""

import atexit
import os
import signal
import sys

from hexctl.cli.interrupts import (
    INTERRUPTED,
    defer_in_imports,
    forget_deferred,
    not_begun,
    raise_deferred,
)

#: Modules with threads or calls that may outlast a command.
MAY_HANG = ("recording.rrd", "threads")


def main() -> None:
    """Load the command line, run it, and exit with its code."""
    open_closed_streams()
    defer_in_imports()
    # Matrices are small here: threads of the linear algebra wait longer than they work, and take cores from
    # the simulation and the 50 Hz loop. Read when NumPy and SciPy are imported.
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    # Python's last act restores the default, with which Ctrl-C would end the process by its signal.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    interrupted = not_begun(sys.argv[1:])
    try:
        if sys.argv[1:2] == ["estop"]:
            from hexctl.cli.network.early_stop import begin_stop

            begin_stop(sys.argv[2:])
        from hexctl.cli.main import exit_code

        raise_deferred()
        interrupted = "interrupted"
        code = exit_code()
        signal.signal(signal.SIGINT, _quit)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, _quit)
        sys.stderr.write(f"hexctl: {interrupted}\n")
        code = INTERRUPTED
    forget_deferred()
    rrd, threads = (sys.modules.get(f"hexctl.{name}") for name in MAY_HANG)
    if (rrd is not None and rrd.stuck()) or (code and threads is not None and threads.simulating()):
        # Python would wait for Rerun on a full disk, or for simulations, and crash at another Ctrl-C.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def open_closed_streams() -> None:
    """Open closed standard streams on /dev/null: the next file or port would get their descriptors."""
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
            os.set_inheritable(number, True)
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


def _quit(*_: object) -> None:
    """A Ctrl-C while threads end need not wait for them."""
    os._exit(INTERRUPTED)
