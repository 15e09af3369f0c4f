"""`make check` finds the tests of what changed."""

from pathlib import Path

import pytest

from tests.changed import COMPATIBILITY, ROOT, changed_paths, mirrored


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ("hexctl/control/guard.py", "tests/control/test_guard.py"),
        ("hexctl/control/guard.py", "tests/control/test_guard_speed.py"),
        ("hexctl/backends/mock.py", "tests/backends/test_mock.py"),
        ("hexctl/backends/sim/world.py", "tests/backends/sim/test_world.py"),
        ("hexctl/errors.py", "tests/test_errors.py"),
        ("tests/control/test_guard.py", "tests/control/test_guard.py"),
        ("tests/control/posed.py", "tests/control"),
        ("docs/gait.md", "tests/docs"),
        ("configs/robots/ant.yaml", "tests/robot/test_configs.py"),
    ],
)
def test_the_tests_of_a_file(changed: str, found: str) -> None:
    assert Path(found) in mirrored(Path(changed))


def test_a_module_without_tests_of_its_name_has_those_of_its_folder() -> None:
    assert mirrored(Path("hexctl/control/no_such_module.py")) == [Path("tests/control"), COMPATIBILITY]
    assert mirrored(Path("hexctl/adapt/prior/no_such_module.py")) == [
        Path("tests/adapt/prior"),
        COMPATIBILITY,
    ]


def test_what_has_no_tests_is_passed_over() -> None:
    assert mirrored(Path("Makefile")) == []
    assert mirrored(Path("tests/control/test_that_was_deleted.py")) == []


def test_what_changed_is_below_the_root() -> None:
    assert all(not path.is_absolute() for path in changed_paths())
    assert (ROOT / "Makefile").is_file()
