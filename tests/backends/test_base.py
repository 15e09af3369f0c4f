"""The servos wrapper, and robots given by name."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from hexctl.backends.base import LegServos, ServosWrapper, as_robot
from hexctl.backends.clock import WallClock
from hexctl.backends.mock import MockServos
from hexctl.control.guard import Guard
from hexctl.errors import InputError, WrongTypeError
from hexctl.robot.configs import config_root
from hexctl.robot.failure import Failure
from hexctl.serve.served_servos import ServedServos
from hexctl.testing import LegServosConformance
from hexctl.types import JointTargets
from tests.backends.fake_time import FakeTime
from tests.robots import shipped

PUBLIC = sorted(name for name in dir(LegServos) if not name.startswith("_"))


class Recorder(MockServos):
    """Servos whose every property says something else than the default, and whose calls are kept."""

    injects_failure = True
    failure = Failure(leg=3)
    simulated: Mapping[str, str] | None = {"world": "slope", "failure": "leg 3 locked"}
    calls: list[str]

    def __init__(self) -> None:
        super().__init__(shipped(), clock=FakeTime().clock())
        self.calls = []

    @property
    def link_counts(self) -> dict[str, int]:
        return {"lost": 7}

    def pause_watchdog(self) -> None:
        self.calls.append("pause_watchdog")

    def change_leg(self, leg: int, failure: Failure | None) -> None:
        self.calls.append(f"leg {leg} {failure}")


class TestServosWrapper(LegServosConformance):
    def make(self) -> LegServos:
        return ServosWrapper(MockServos(shipped(), clock=FakeTime().clock()))


def test_a_wrapper_forwards_every_public_attribute() -> None:
    assert [name for name in PUBLIC if name not in vars(ServosWrapper)] == []
    called: list[str] = []

    class Inner(Recorder):
        def __getattribute__(self, name: str) -> Any:
            called.append(name)
            return super().__getattribute__(name)

    wrapper = ServosWrapper(Inner())
    targets = JointTargets(shipped().stance_angles_rad, 0.0)
    arguments: dict[str, tuple[Any, ...]] = {"write": (targets,), "change_leg": (5, None)}
    wrapper.connect()
    for name in [*(name for name in PUBLIC if name not in ("close", "connect")), "close"]:
        called.clear()
        value = getattr(wrapper, name)
        if callable(value):
            value(*arguments.get(name, ()))
        assert name in called, name


@pytest.mark.parametrize("wrap", [ServosWrapper, Guard, ServedServos])
def test_what_wraps_servos_is_as_they_are(wrap: type[ServosWrapper]) -> None:
    servos = Recorder()
    with wrap(servos) as wrapper:
        for name in ("robot", "clock", "injects_failure", "failure", "simulated", "identity", "link_counts"):
            assert getattr(wrapper, name) == getattr(servos, name), name
        wrapper.pause_watchdog()
        assert servos.calls == ["pause_watchdog"]
        assert wrapper.disable_torque()
        assert servos.limp
        assert wrap(wrapper).unwrapped is servos


def test_what_a_simulation_says_after_connecting_is_forwarded() -> None:
    servos = MockServos(shipped(), clock=FakeTime().clock())
    guard = Guard(servos)
    servos.simulated, servos.failure = {"failure": "none"}, Failure(leg=2)
    assert guard.simulated == {"failure": "none"}
    assert guard.failure == Failure(leg=2)


def test_a_robot_is_taken_by_its_name() -> None:
    assert MockServos("phantomx").robot.name == "phantomx"
    np.testing.assert_array_equal(as_robot("ant").stance_angles_rad, shipped().stance_angles_rad)
    assert MockServos(config_root() / "robots" / "pexod.yaml").robot.name == "pexod"
    with pytest.raises(InputError, match="unknown robot 'spider'"):
        MockServos("spider")
    with pytest.raises(WrongTypeError, match=r"robot: got 3 \(int\); allowed: a Robot, or the name or path"):
        MockServos(3)  # type: ignore[arg-type]
    assert isinstance(MockServos("ant").clock, WallClock)
