"""Tests in real time are kept apart, and what shares something expensive stays together."""

import re
from pathlib import Path

from tests.schedule import (
    EARLY,
    LONG,
    MEASURED,
    REALTIME,
    SLOW,
    SPREAD,
    markers_of,
    may_select,
    rank,
    scope_of,
)

TESTS = Path(__file__).parent
#: What a file would mark its tests with by itself.
BY_ITSELF = re.compile(r"mark\.(realtime|slow|long)\b")


def test_no_file_marks_its_own_tests() -> None:
    marked = [path for path in TESTS.rglob("*.py") if BY_ITSELF.search(path.read_text(encoding="utf-8"))]
    assert not marked, "tests/schedule.py says what is slow or in real time"


def test_what_is_named_exists() -> None:
    for name in (*EARLY, *LONG, *SLOW, *SPREAD, *REALTIME, *sorted(MEASURED)):
        file, _, test = name.partition("::")
        assert (TESTS.parent / file).exists(), name
        assert not test or f"def {test.partition('[')[0]}" in (TESTS.parent / file).read_text(), name


def test_scopes_and_ranks() -> None:
    link, walk = "tests/server/test_link_faults.py::test_a", "tests/control/test_guard.py::test_b"
    alone = "tests/adapt/test_kill.py::test_c[dps]"
    page = f"{REALTIME[0]}[README.md]"
    assert scope_of(link) == "tests/server/test_link_faults.py"
    assert scope_of(walk) == "tests/control/test_guard.py"
    assert (scope_of(alone), scope_of(page)) == (alone, page)
    assert rank(page) < rank(link) < rank(f"{EARLY[0]}::test_d") < rank(alone) < rank(walk)


def test_markers_follow_from_the_place() -> None:
    assert markers_of("tests/server/test_link_faults.py::test_a") == ["realtime"]
    assert markers_of("tests/viewer/test_web.py::test_b") == ["slow"]
    assert markers_of("tests/docs/test_commands.py::test_the_commands_of_a_page[README.md]") == [
        "realtime",
        "slow",
    ]
    assert markers_of("tests/benchmarks/test_command.py::test_d") == ["slow", "long"]
    assert markers_of("tests/docs/test_commands.py::test_the_commands_of_a_page[see.md]") == [
        "realtime",
        "slow",
        "long",
    ]
    assert markers_of("tests/control/test_guard.py::test_c") == []
    measured = next(name for name in sorted(MEASURED) if "[" not in name)
    assert markers_of(measured) == markers_of(f"{measured}[any]") == ["slow"]
    assert markers_of(f"{measured}_but_another") == []


def test_a_file_of_which_a_lane_has_no_test_is_left_out() -> None:
    quick, slow = "not realtime and not slow and not soak", "slow and not realtime and not long and not soak"
    realtime, long = "realtime and not long and not soak", "long and not realtime and not soak"
    lanes = {
        "tests/control/test_guard.py": [quick],
        "tests/server/test_link_faults.py": [realtime],
        "tests/benchmarks/test_command.py": [long],
        "tests/test_compatibility.py": [quick, slow, long],
        "tests/cli/walk/test_run_command.py": [quick, slow, realtime],
    }
    for file, has in lanes.items():
        assert [lane for lane in (quick, slow, realtime, long) if may_select(lane, file)] == has, file
        assert may_select("soak", file)
        assert may_select("of_another_package and not slow", file)
