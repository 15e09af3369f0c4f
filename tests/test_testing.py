"""The suite finds servos that break their promises, and says what it needs."""

import subprocess
import sys
from pathlib import Path

import pytest

BROKEN = '''
from hexctl import load_robot
from hexctl.backends.mock import MockServos
from hexctl.testing import LegServosConformance
from tests.backends.fake_time import FakeTime


class Deaf(MockServos):
    """Takes whatever it is told."""

    def write(self, targets):
        return targets


class TestMock(LegServosConformance):
    def make(self):
        return MockServos(load_robot("ant"), clock=FakeTime().clock())


class TestDeaf(LegServosConformance):
    def make(self):
        return Deaf(load_robot("ant"), clock=FakeTime().clock())


class TestNothing(LegServosConformance):
    pass
'''


@pytest.mark.slow
def test_good_servos_pass_and_bad_ones_fail(tmp_path: Path) -> None:
    (tmp_path / "test_mine.py").write_text(BROKEN, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", "-rf", str(tmp_path)],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 1
    assert "TestMock" not in done.stdout
    for name in ("a_small_change_is_reached_within_a_second", "targets_that_are_not_finite_are_refused"):
        assert f"TestDeaf::test_{name}" in done.stdout
    assert "make: returns your servos, not connected" in done.stdout


def test_without_pytest_it_says_what_to_install() -> None:
    code = "import sys; sys.modules['pytest'] = None; import hexctl; import hexctl.testing"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert "[testing]" in done.stderr
