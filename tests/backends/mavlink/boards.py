"""Servo boards for tests: `hexctl sim board` in a process, and boards in memory on simulated time."""

import json
import re
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self
from unittest.mock import patch

import numpy as np

from faults.process import free_port
from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.backends.mavlink.mavlink_client import MavlinkServos
from hexctl.backends.mavlink.mavlink_transport import Address, Port
from hexctl.backends.mock import MockServos
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.simulators import board_messages
from hexctl.simulators.servo_board import ServoBoard
from hexctl.types import FloatArray
from tests.backends.fake_time import FakeTime
from tests.robots import edited_file, put, shipped
from tests.server.processes import Program, program

#: How long anything may take on a machine that does other things too.
PATIENCE_S = 30.0

#: The tibias of `ant` turn about -75 degrees; mounted straight, their servos would end before the stance.
FITTING = {"tibia": {"offset_deg": 75}}


def fitting_file(folder: Path, servos: dict[str, Any] | None = None, base: str = "ant") -> Path:
    """Write a robot file with a servo map into a folder and return its path."""
    return edited_file(folder, put("servos", {**FITTING, **(servos or {})}), base=base)


def fitting_map(folder: Path) -> ServoMap:
    return load_robot_file(fitting_file(folder)).servo_map


@dataclass
class BoardProcess:
    """`hexctl sim board` in a process of its own, and what to connect to."""

    program: Program
    port: str

    @property
    def process(self) -> "subprocess.Popen[str]":
        """The process; tests may signal it."""
        return self.program.process

    def end(self) -> dict[str, Any]:
        """End it as Ctrl-C does and return its report."""
        self.program.signal(signal.SIGINT)
        assert self.program.wait() == 0, self.program.said()
        report: dict[str, Any] = json.loads(self.program.said().splitlines()[-1])
        return report


@contextmanager
def board(*arguments: str, pty: bool = False) -> Iterator[BoardProcess]:
    """Run a board for a while."""
    number = free_port(socket.SOCK_DGRAM)
    where = ["--pty"] if pty else ["--port", f"udpin:127.0.0.1:{number}"]
    words = ("hexctl", "sim", "board", *([] if "--bus" in arguments else where), "--json", *arguments)
    with TemporaryDirectory() as folder, program(Path(folder), "board", *words) as running:
        running.wait_for("Ctrl-C ends it")
        found = re.search(r"(?<= at )/[^\s,;]+", running.said())
        yield BoardProcess(running, found[0] if found else f"udpout:127.0.0.1:{number}")


class MemoryPort(Port):
    """A port in memory, on whose time its threads wait.

    Attributes:
        time: of everything on it; it passes while the test's own thread waits.
        others: the ports of its peers, by the addresses that this end sends to; None is the board.
        gone: whether the other end has gone.
    """

    datagrams = True

    def __init__(self, time: FakeTime, name: str | None = None) -> None:
        super().__init__()
        self.time, self.name, self.gone = time, name, False
        self.others: dict[Address, MemoryPort] = {}
        self._came: list[tuple[bytes, Address]] = []
        self._news = threading.Event()

    def peer(self, name: str = "controller") -> "MemoryPort":
        """A port whose frames come to this one."""
        made = MemoryPort(self.time, name)
        made.others[None], self.others[name] = self, made
        return made

    def put(self, data: bytes, sender: Address) -> None:
        """Let bytes come."""
        self._came.append((data, sender))
        self._news.set()

    def receive(self, timeout_s: float) -> list[tuple[bytes, Address]]:
        self.time.wait(self._news, timeout_s)
        if self.gone:
            raise OSError("the other end of the port has gone")
        self._news.clear()
        came, self._came = self._came, []
        return came

    def send(self, frame: bytes, to: Address) -> None:
        if (other := self.others.get(to)) is not None:
            other.put(frame, self.name)

    def close(self) -> None:
        """Nothing is open."""


@dataclass
class MemoryBoard:
    """The simulated servo board, in a thread on simulated time.

    Attributes:
        port: of the board.
        servo_map: of its servos.
        robot: that it moves.
    """

    port: MemoryPort
    servo_map: ServoMap
    robot: MockServos
    board: ServoBoard
    stopping: threading.Event = field(default_factory=threading.Event)

    @property
    def time(self) -> FakeTime:
        """Of everything on it."""
        return self.port.time

    def end(self) -> dict[str, Any]:
        """Let it end and return its report."""
        self.stopping.set()
        self.time.sleep(0.1)
        return self.board.report()


class OnMemory(MavlinkServos):
    """A client at a port in memory."""

    memory_port: MemoryPort

    def _open_all(self, opening: ExitStack) -> None:
        with patch("hexctl.backends.mavlink.mavlink_client.open_port", lambda *_, **__: self.memory_port):
            super()._open_all(opening)


def servos_on(
    port: MemoryPort, servo_map: ServoMap, *, name: str = "controller", key: bytes | None = None
) -> "OnMemory":
    """A client of the board at a port in memory, not connected."""
    clock = port.time.clock()
    servos = OnMemory(shipped(), servo_map=servo_map, port="udpout:here:1", clock=clock, signing_key=key)
    servos.memory_port = port.peer(name)
    return servos


@contextmanager
def memory_board(servo_map: ServoMap, **options: Any) -> Iterator[MemoryBoard]:
    """Run a board in memory meanwhile, with options of `ServoBoard`."""
    port = MemoryPort(FakeTime())
    robot = MockServos(shipped(), clock=port.time.clock())
    running = MemoryBoard(port, servo_map, robot, ServoBoard(robot, servo_map, port, **options))
    ready = threading.Event()
    run, until = running.board.run, running.stopping.is_set
    thread = threading.Thread(target=run, args=(until,), kwargs={"ready": ready.set})
    thread.start()
    try:
        while not ready.wait(0.001):
            port.time.sleep(0.01)
        yield running
    finally:
        running.stopping.set()
        port.time.join(thread)


class ScriptedBoard:
    """A board in memory: it beats, says where its servos are, and whatever else it is told to.

    Attributes:
        port: of the board.
        pulses_us: what it says of its channels, (18,).
        active: the mask that it says.
        kind: MAV_TYPE under which it shows itself.
        state: MAV_STATE of its heartbeat.
        extra: messages that it sends every period.
        silent: True to say nothing but heartbeats.
        heard: frames that came, newest last.
    """

    def __init__(self, *, port: MemoryPort | None = None, signing_key: bytes | None = None) -> None:
        self.port = MemoryPort(FakeTime()) if port is None else port
        self.pulses_us: FloatArray = np.full(18, 1500.0)
        self.active = 0x3FFFF
        self.kind, self.state = 0, mavlink_messages.ACTIVE
        self.extra: list[Any] = []
        self.silent = False
        self.heard: list[Frame] = []
        self._codec = Codec(1, 1, signing_key=signing_key)
        self._ears = Codec(1, 1, signing_key=signing_key)
        self.sequence = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.port.time.join(self._thread)

    def say(self, message: Any) -> None:
        """Send one message to everyone now."""
        self.sequence += 1
        for address in list(self.port.others):
            self.port.send(self._codec.encode(message, self.sequence), address)

    def overrides(self) -> list[list[int]]:
        """The channels of all overrides received."""
        return [
            mavlink_messages.channels_of(frame.message)
            for frame in list(self.heard)
            if frame.kind == "RC_CHANNELS_OVERRIDE"
        ]

    def _run(self) -> None:
        while not self._over.is_set():
            for data, _ in self.port.receive(0.01):
                self.heard += self._ears.decode(data, whole=True)
            self.say(mavlink_messages.heartbeat(self.kind, 0, self.state))
            if not self.silent:
                mask = np.array([self.active >> channel & 1 for channel in range(18)], dtype=bool)
                self.say(board_messages.outputs(self.pulses_us, mask, 0.0))
                for message in list(self.extra):
                    self.say(message)
