"""The servos wrapper, the mock robot, and robots given by name."""

from collections.abc import Mapping
from typing import Self

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
from hexctl.control.guard import Guard
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
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
        assert connection_notes(Guard(unserved), None) == [UNSERVED]
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
