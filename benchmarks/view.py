"""What a live view costs a robot: the lateness of loops that are shown, and of loops that are not.

All run at the same time, as in the clock benchmark. The viewers save what they are sent, because a benchmark
has no screen: what drawing takes of the machine is not in it, what talking to a viewer takes is.
"""

from collections.abc import Iterator

from benchmarks.clock import lateness_ratio, run_together
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.clock import PERIOD_S

#: Loops of each kind.
PAIRS = 2

#: Time for the viewers to be ready before the first tick.
HEAD_START_S = 8.0


def view_rows(scale: Scale) -> Iterator[Row]:
    """Lateness of hexctl's loop on the wall clock with a live view over that of loops without."""
    expected = round(scale.clock_s / PERIOD_S)
    loops = run_together(("viewed", "hexctl") * PAIRS, expected, HEAD_START_S)
    value = lateness_ratio(loops["viewed"], loops["hexctl"], scale.clock_s)
    yield Row("view.lateness_p99", value, "ratio", Bar(high=1.5), "p99 over loops without a live view")
