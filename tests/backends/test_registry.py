"""The table of backends: known names, a LegServos of one's own, and what is refused."""

import sys
from pathlib import Path

import pytest

from hexctl.backends.mock import MockServos
from hexctl.backends.registry import BACKENDS, BackendOptions, make_servos
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from tests.robots import shipped

OPTIONS = BackendOptions(robot=shipped(), world=World(friction=0.5), failure=Failure(leg=2), seed=7)


def test_the_simulation_gets_its_world_failure_and_seed() -> None:
    servos = make_servos("sim", OPTIONS)
    assert isinstance(servos, SimServos)
    assert (servos.world, servos.failure, servos.seed) == (OPTIONS.world, OPTIONS.failure, 7)
    assert servos.robot is OPTIONS.robot


def test_the_mock_gets_its_robot() -> None:
    servos = make_servos("mock", OPTIONS)
    assert isinstance(servos, MockServos)
    assert servos.robot is OPTIONS.robot


@pytest.mark.parametrize("name", ["hardware", "", "Sim"])
def test_an_unknown_backend_lists_the_known_ones(name: str) -> None:
    with pytest.raises(InputError) as refused:
        make_servos(name, OPTIONS)
    message = str(refused.value)
    assert repr(name) in message
    for known in BACKENDS:
        assert known in message
    assert "\n" not in message


@pytest.fixture
def own_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Put a module with servos of one's own on the path and return its name."""
    (tmp_path / "my_servos.py").write_text(
        "from hexctl.backends.mock import MockServos\n"
        "class Mine(MockServos):\n    pass\n"
        "class NoServos:\n    def __init__(self, robot): pass\n"
        "class WantsMore:\n    def __init__(self, robot, port): pass\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_servos", raising=False)
    return "my_servos"


def test_servos_of_ones_own_are_made_for_the_robot(own_module: str) -> None:
    servos = make_servos(f"{own_module}:Mine", OPTIONS)
    assert type(servos).__name__ == "Mine"
    assert servos.robot is OPTIONS.robot


@pytest.mark.parametrize(
    "name", ["my_servos:Missing", "no_such_module:Mine", "my_servos:WantsMore", "my_servos:"]
)
@pytest.mark.usefixtures("own_module")
def test_servos_of_ones_own_that_cannot_be_made_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="cannot be loaded") as refused:
        make_servos(name, OPTIONS)
    assert repr(name) in str(refused.value)


def test_a_class_that_is_no_leg_servos_is_refused(own_module: str) -> None:
    with pytest.raises(InputError, match="made a NoServos; allowed: a subclass of LegServos"):
        make_servos(f"{own_module}:NoServos", OPTIONS)
