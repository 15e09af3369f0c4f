"""However a hand, a page, a terminal or a link goes, the robot comes to rest, and how fast, a hundred times.

The figures of docs/results/results.md are what the soak tests print.
"""

import sys
from pathlib import Path

import pytest

from pictures.needed import MissingProgramError
from tests.cli.stopping.measure import CAUSES, Measurement, Stops
from tests.viewer.conftest import give_up

pytestmark = [pytest.mark.long, pytest.mark.realtime]

TIMES = 100

#: Those that no other test has, one of each kind.
FEW = (
    "pad-gone",
    "page-silent",
    "page-killed",
    "terminal-closed",
    "terminal-killed",
    "terminal-frozen",
    "link-held",
)


def measured(name: str, times: int, folder: Path) -> Stops:
    """Stops of a cause; skips where there is no browser for it."""
    try:
        return Measurement(name, times, folder).run()
    except MissingProgramError as error:
        give_up(error)
        raise


@pytest.mark.parametrize("name", FEW)
def test_a_robot_whose_driver_goes_comes_to_rest(name: str, tmp_path: Path) -> None:
    assert len(measured(name, 2, tmp_path).rest_s) == 2


@pytest.mark.soak
@pytest.mark.parametrize("name", CAUSES)
def test_a_robot_is_at_rest_in_time_a_hundred_times_of_a_hundred(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stops = measured(name, TIMES, tmp_path)
    with capsys.disabled():
        sys.stdout.write(f"\n{name}: {stops}\n")
    assert stops.within == len(stops.rest_s) >= TIMES, stops
