"""The zenoh backend conforms, with a mock and with a simulation served by another process."""

from collections.abc import Iterator

import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.zenoh.servos import ZenohServos
from hexctl.wire.link import Link
from tests.backends.conformance import LegServosConformance
from tests.robots import shipped
from tests.serve.processes import Served, served


class ServedConformance(LegServosConformance):
    """The suite over a link; each class of tests has a robot of its own."""

    backend = "mock"
    robot: Served

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _robot(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        with served(tmp_path_factory.mktemp("robot"), backend=cls.backend) as robot:
            cls.robot = robot
            yield

    def make(self) -> LegServos:
        return ZenohServos(shipped(), link=Link(endpoint=self.robot.endpoint))


class TestServedMock(ServedConformance):
    backend = "mock"


class TestServedSimulation(ServedConformance):
    backend = "sim"
