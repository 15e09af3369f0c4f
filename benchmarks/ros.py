"""ROS: what `hexctl serve --ros` costs a core."""

import json
import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import zenoh

from benchmarks.link import free_port, served
from benchmarks.plans import ant
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.backends.zenoh.zenoh_client import ZenohServos
from hexctl.types import JointTargets
from hexctl.wire.links import Endpoint, Link
from hexctl.wire.ros.ros_session import open_ros_session

#: Rest before and after the messages.
REST_S = 1.0


def ros_rows(scale: Scale) -> Iterator[Row]:
    """Two simulations in real time, one of them a node whose topics are all subscribed to."""
    (plain, with_ros), messages = _measured(round(scale.link_s / PERIOD_S))
    note = f"next to a simulation, all topics subscribed to ({messages} messages); a core is 100"
    yield Row("ros.cpu.extra", 100 * (with_ros - plain), "% of a core", Bar(high=10), note)


def _measured(times: int) -> tuple[list[float], int]:
    """Return the share of a core that each robot took, and how much ROS heard."""
    heard = [0]

    def hear(_: zenoh.Sample) -> None:
        heard[0] += 1

    with ExitStack() as stack:
        router = f"tcp/127.0.0.1:{free_port()}"
        stack.enter_context(_router(router))
        session = stack.enter_context(open_ros_session(Endpoint.parse(router)))
        session.declare_subscriber("0/**", hear)
        robots = [stack.enter_context(_Served.opened(options)) for options in ([], ["--ros", router])]
        time.sleep(REST_S)
        began = [(robot.cpu_s(), time.monotonic()) for robot in robots]
        clock, stance = WallClock(), ant().stance_angles_rad
        for _ in range(times):
            clock.tick()
            for robot in robots:
                robot.servos.write(JointTargets(stance, 0.0))
        shares = [
            (robot.cpu_s() - cpu_s) / (time.monotonic() - at_s)
            for robot, (cpu_s, at_s) in zip(robots, began, strict=True)
        ]
        return shares, heard[0]


class _Served:
    """A served simulation with a controller on its link."""

    def __init__(self, process: subprocess.Popen[str], servos: ZenohServos) -> None:
        self._process, self.servos = process, servos

    @classmethod
    @contextmanager
    def opened(cls, options: list[str]) -> Iterator["_Served"]:
        """Serve a simulation until the block ends."""
        port = free_port()
        link = Link(endpoint=f"tcp/127.0.0.1:{port}")
        with served(port, "sim", *options) as process, ZenohServos(ant(), link=link) as servos:
            yield cls(process, servos)

    def cpu_s(self) -> float:
        """Time that its process has had of all cores so far."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _router(endpoint: str) -> Iterator[None]:
    """A Zenoh router, as ROS has one."""
    config = zenoh.Config()
    settings = {"mode": "router", "scouting/multicast/enabled": False, "listen/endpoints": [endpoint]}
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield
