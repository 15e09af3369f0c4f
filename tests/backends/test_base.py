"""The servos wrapper, the mock robot, backends by name, and custom servos."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from hexctl.backends.base import (
    UNSERVED,
    LegServos,
    ServosWrapper,
    TruePose,
    connection_notes,
    failures_in_force,
    simulation_of,
)
from hexctl.backends.mock import MockServos
from hexctl.backends.registry import BACKENDS, BackendOptions, check_options, make_servos
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot_file
from hexctl.runs.run_spec import RunSpec
from hexctl.server.served_servos import ServedServos
from hexctl.testing import LegServosConformance
from hexctl.types import JointTargets
from hexctl.wire.description import RobotIdentity
from hexctl.wire.links import Link
from tests.backends.bus.boards import a_map, memory_bus, servos_on
from tests.backends.fake_time import FakeTime
from tests.robots import shipped

PUBLIC = sorted(name for name in dir(LegServos) if not name.startswith("_"))


class BreakingServos(MockServos):
    """Servos of a simulation, as far as their failures go."""

    failures: tuple[Failure, ...] = (Failure(leg=2), Failure(leg=5))
    true_pose: TruePose | None = None

    @property
    def simulation(self) -> Self:
        return self

    def change_leg(self, leg: int, failure: Failure | None) -> None:
        raise NotImplementedError

    def walk_begins(self) -> None:
        raise NotImplementedError


class ServedMock(MockServos):
    """Servos behind a server, as far as an operator is told of them."""

    identity = RobotIdentity(robot="ant", backend="sim", host="lab-pc", user="alice", pid=4711)
    link, failures = Link(), (Failure(leg=2, kind="limp"),)
    simulated: Mapping[str, str] | None = {"world": "flat", "failure": "leg 2 limp"}

    @property
    def remote(self) -> Self:
        return self


class EchoingBoard(MockServos):
    """Servos of a robot that report their targets as positions."""

    moves_hardware = True


class Recorder(BreakingServos, ServedMock):  # type: ignore[misc]  # the failures are those of the simulation
    """Servos whose every property says something else than the default, and whose calls are kept."""

    calls: list[str]

    def __init__(self) -> None:
        super().__init__(shipped(), clock=FakeTime().clock())
        self.calls = []

    @property
    def link_counts(self) -> dict[str, int]:
        return {"lost": 7}

    def pause_watchdog(self) -> None:
        self.calls.append("pause_watchdog")


class TestMockServos(LegServosConformance):
    def make(self) -> LegServos:
        return MockServos(shipped(), clock=FakeTime().clock())


def test_a_mock_echoes_and_keeps_its_targets_newest_last() -> None:
    with MockServos(shipped(), clock=FakeTime().clock()) as servos:
        assert not servos.read().measured
        for angle in (0.1, 0.2, 0.3):
            servos.write(JointTargets(np.full(18, angle), angle))
        assert [targets.joint_positions_rad[0] for targets in servos.sent] == [0.1, 0.2, 0.3]
        np.testing.assert_array_equal(servos.read().joint_positions_rad, np.full(18, 0.3))


class TestServosWrapper(LegServosConformance):
    def make(self) -> LegServos:
        return ServosWrapper(MockServos(shipped(), clock=FakeTime().clock()))


def test_a_wrapper_forwards_every_public_attribute() -> None:
    assert [name for name in PUBLIC if name not in vars(ServosWrapper)] == []


@pytest.mark.parametrize("wrap", [ServosWrapper, Guard, ServedServos])
def test_what_wraps_servos_is_as_they_are(wrap: type[ServosWrapper]) -> None:
    servos = Recorder()
    with wrap(servos) as wrapper:
        for name in ("robot", "clock", "simulation", "remote", "link_counts"):
            assert getattr(wrapper, name) == getattr(servos, name), name
        wrapper.pause_watchdog()
        assert servos.calls == ["pause_watchdog"]
        assert wrapper.disable_torque()
        assert servos.limp
        assert wrap(wrapper).unwrapped is servos


def test_an_operator_is_told_whose_robot_it_is_and_what_a_simulation_breaks() -> None:
    with ServedMock("ant") as servos:
        whose, breaks = connection_notes(Guard(servos), None)
        assert "alice on lab-pc" in whose
        assert "leg 2 limp" in breaks
        assert connection_notes(servos, Failure(leg=2, kind="limp")) == [whose]
    with BreakingServos("ant") as simulated:
        (note,) = connection_notes(Guard(simulated), Failure(leg=5))
        assert "leg 2 locked" in note
        assert connection_notes(simulated, simulated.failures) == []
    with memory_bus(a_map()) as bus, servos_on(bus, a_map()) as unserved:
        served, missing = connection_notes(Guard(unserved), None)
        assert served == UNSERVED
        assert "foot contacts" in missing
        assert "joint positions" not in missing
    with EchoingBoard(replace(shipped(), sensors=("joint_positions", "imu"))) as echoing:
        assert "joint positions" in connection_notes(echoing, None)[1]
    with EchoingBoard(replace(shipped(), sensors=("imu",))) as honest:
        assert connection_notes(honest, None) == [UNSERVED]
    with MockServos("ant") as unreal:
        assert connection_notes(unreal, None) == []


def test_failures_in_force_are_those_of_a_simulation_here_or_there() -> None:
    assert failures_in_force(Guard(BreakingServos("ant"))) == BreakingServos.failures
    assert failures_in_force(Guard(ServedMock("ant"))) == ServedMock.failures
    assert failures_in_force(Guard(MockServos("ant"))) is None


def test_only_a_simulation_breaks_legs() -> None:
    simulated = BreakingServos("ant")
    assert simulation_of(Guard(simulated)) is simulated
    with pytest.raises(InputError, match=r"failure: .*real robot"):
        simulation_of(Guard(MockServos("ant")))


# Backends by name.

OPTIONS = BackendOptions(robot=shipped(), world=World(friction=0.5), failures=(Failure(leg=2),), seed=7)


def test_the_simulation_gets_its_world_failure_and_seed() -> None:
    servos = make_servos("sim", OPTIONS)
    assert isinstance(servos, SimServos)
    assert (servos.world, servos.failures, servos.seed) == (OPTIONS.world, OPTIONS.failures, 7)
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
        "class NoServos:\n    def __init__(self, robot): pass\n"
        "class WantsMore:\n    def __init__(self, robot, port): pass\n"
        "from hexctl.backends.sim.servos import SimServos\n"
        "class Simulator(SimServos):\n    pass\n"
        "class Bus(MockServos):\n"
        "    def __init__(self, robot, *, port='/dev/bus', credentials=None, servo_map=None, **more):\n"
        "        super().__init__(robot)\n"
        "        self.given = (port, credentials, servo_map, more)\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_servos", raising=False)
    return "my_servos"


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
    options = replace(OPTIONS, port="/dev/ttyUSB3", credentials=tmp_path, robot_file=file, link="lab")
    servos: Any = make_servos(f"{own_module}:Bus", options)
    assert servos.robot is OPTIONS.robot
    assert servos.given == ("/dev/ttyUSB3", tmp_path, file.servo_map, {})
    servos = make_servos(f"{own_module}:Bus", OPTIONS)
    assert servos.given[:2] == ("/dev/bus", None)


def test_a_simulator_of_ones_own_gets_world_failure_and_seed(own_module: str) -> None:
    servos: Any = make_servos(f"{own_module}:Simulator", OPTIONS)
    assert (servos.world, servos.failures, servos.seed) == (OPTIONS.world, OPTIONS.failures, 7)
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
    check_options(f"{own_module}:Bus", port="x", credentials="y", seed=0)
    with pytest.raises(InputError, match=r"^device: got x .*with mavlink$"):
        check_options(
            "mock", names={"port": "device"}, but=tuple(BACKENDS.keys() - {"sim", "mavlink"}), port="x"
        )


def test_options_are_those_of_a_spec_except_where_they_are_given(tmp_path: Path) -> None:
    spec = RunSpec(robot="pexod", world="rough", seed=4, connect="tcp/a:1", credentials=str(tmp_path))
    options = BackendOptions.of(spec, robot=shipped(), world=OPTIONS.world)
    assert options == BackendOptions(
        robot=shipped(), world=OPTIONS.world, seed=4, connect="tcp/a:1", credentials=tmp_path
    )
