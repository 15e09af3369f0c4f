"""Registry of backends: known names, options, a LegServos of your own, and what is refused."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.backends.registry import BACKENDS, BackendOptions, check_options, make_servos
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot_file
from hexctl.runs.run_spec import RunSpec
from tests.robots import shipped

OPTIONS = BackendOptions(robot=shipped(), world=World(friction=0.5), failure=Failure(leg=2), seed=7)


def test_the_simulation_gets_its_world_failure_and_seed() -> None:
    servos = make_servos("sim", OPTIONS)
    assert isinstance(servos, SimServos)
    assert (servos.world, servos.failure, servos.seed) == (OPTIONS.world, OPTIONS.failure, 7)
    assert servos.robot is OPTIONS.robot


@pytest.mark.parametrize("name", ["hardware", "", "Sim"])
def test_an_unknown_backend_lists_the_known_ones(name: str) -> None:
    with pytest.raises(InputError, match=repr(name)) as refused:
        make_servos(name, OPTIONS)
    assert all(known in str(refused.value) for known in BACKENDS)


@pytest.fixture
def own_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Put a module with servos of one's own on the path and return its name."""
    (tmp_path / "my_servos.py").write_text(
        "from hexctl.backends.mock import MockServos\n"
        "class Mine(MockServos):\n    pass\n"
        "class NoServos:\n    def __init__(self, robot): pass\n"
        "class WantsMore:\n    def __init__(self, robot, port): pass\n"
        "from hexctl.backends.sim.servos import SimServos\n"
        "class Simulator(SimServos):\n    pass\n"
        "class Bus(MockServos):\n"
        "    def __init__(self, robot, *, connect='/dev/bus', credentials=None, servo_map=None, **more):\n"
        "        super().__init__(robot)\n"
        "        self.given = (connect, credentials, servo_map, more)\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_servos", raising=False)
    return "my_servos"


def test_servos_of_ones_own_are_made_for_the_robot(own_module: str) -> None:
    servos = make_servos(f"{own_module}:Mine", OPTIONS)
    assert type(servos).__name__ == "Mine"
    assert servos.robot is OPTIONS.robot


@pytest.mark.parametrize("name", ["my_servos:NoServos", "my_servos:Missing", "no_such_module:Mine"])
@pytest.mark.usefixtures("own_module")
def test_servos_of_ones_own_that_cannot_be_made_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=name):
        make_servos(name, OPTIONS)
    for other in ("my_servos:WantsMore", "my_servos:"):
        with pytest.raises(InputError, match=other):
            make_servos(other, OPTIONS)


def test_servos_of_ones_own_get_the_options_that_they_take(own_module: str, tmp_path: Path) -> None:
    file = load_robot_file("ant")
    options = replace(OPTIONS, connect="/dev/ttyUSB3", credentials=tmp_path, robot_file=file, link="lab")
    servos: Any = make_servos(f"{own_module}:Bus", options)
    assert servos.given == ("/dev/ttyUSB3", tmp_path, file.servo_map, {})
    servos = make_servos(f"{own_module}:Bus", OPTIONS)
    assert servos.given[:2] == ("/dev/bus", None)


def test_a_simulator_of_ones_own_gets_world_failure_and_seed(own_module: str) -> None:
    servos: Any = make_servos(f"{own_module}:Simulator", OPTIONS)
    assert (servos.world, servos.failure, servos.seed) == (OPTIONS.world, OPTIONS.failure, 7)
    check_options(f"{own_module}:Simulator", world="slippery", seed=3, realtime=True)


@pytest.mark.parametrize(
    ("name", "given", "named"),
    [
        ("mock", {"seed": 3}, "seed: got 3 .*with sim"),
        ("sim", {"connect": "there"}, "connect: got there .*with zenoh"),
        ("my_servos:Bus", {"seed": 3}, "seed"),
        ("my_servos:Missing", {}, "my_servos:Missing"),
        ("hardware", {}, "backend: got 'hardware'"),
        ("mock", {"robot_file": 3}, "robot_file: got 3 .*with none"),
    ],
)
@pytest.mark.usefixtures("own_module")
def test_options_that_a_backend_would_ignore_are_refused(
    name: str, given: dict[str, Any], named: str
) -> None:
    with pytest.raises(InputError, match=named):
        check_options(name, **given)


def test_options_that_a_backend_takes_pass_and_others_have_the_names_of_the_caller(own_module: str) -> None:
    check_options("sim", seed=3, realtime=True, world="flat", connect=None)
    check_options("zenoh", connect="tcp/a:1", link="lab", insecure=True, seed=0)
    check_options(f"{own_module}:Bus", connect="x", credentials="y", seed=0)
    with pytest.raises(InputError, match=r"^device: got x .*with mavlink$"):
        check_options("mock", names={"connect": "device"}, offered=("sim", "mavlink"), connect="x")


def test_options_are_those_of_a_spec_except_where_they_are_given(tmp_path: Path) -> None:
    spec = RunSpec(robot="pexod", world="rough", seed=4, connect="tcp/a:1", credentials=str(tmp_path))
    options = BackendOptions.of(spec, robot=shipped(), world=OPTIONS.world)
    assert options == BackendOptions(
        robot=shipped(), world=OPTIONS.world, seed=4, connect="tcp/a:1", credentials=tmp_path
    )
