"""Servo boards for tests: `hexctl sim board` in a process of its own, and one that says what a test wants."""

import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from hexctl.backends.clock import WallClock
from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.simulators import board_messages
from hexctl.time_source import TimeSource
from hexctl.types import FloatArray
from hexctl.waiting import wait_for
from tests.robots import edited_file, put, shipped

#: How long anything may take on a machine that does other things too.
PATIENCE_S = 30.0

#: The tibias of `ant` turn about -75 degrees; mounted straight, their servos would end before the stance.
FITTING = {"tibia": {"offset_deg": 75}}


def fitting_file(folder: Path, servos: dict[str, Any] | None = None, base: str = "ant") -> Path:
    """Write a robot file with a servo map into a folder and return its path."""
    return edited_file(folder, put("servos", {**FITTING, **(servos or {})}), base=base)


def fitting_map(folder: Path) -> ServoMap:
    return load_robot_file(fitting_file(folder)).servo_map


def free_port() -> int:
    """A free UDP port of this computer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass(frozen=True)
class FastTime(TimeSource):
    """Time whose seconds are shorter."""

    speed: float = 4.0

    def now(self) -> float:
        return self.speed * super().now()

    def sleep(self, duration_s: float) -> None:
        super().sleep(duration_s / self.speed)


def fast_clock() -> WallClock:
    """A clock whose seconds are shorter."""
    return WallClock(time=FastTime())


class BoardProcess:
    """`hexctl sim board` in a process of its own.

    Attributes:
        process: the process; tests may signal it.
        port: what to connect to.
    """

    def __init__(self, *arguments: str, pty: bool = False) -> None:
        number = free_port()
        where = ["--pty"] if pty else ["--connect", f"udpin:127.0.0.1:{number}"]
        where = [] if "--bus" in arguments else where
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hexctl", "sim", "board", *where, "--json", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "MUJOCO_GL": "disable"},
        )
        greeting = self._greeting()
        found = re.search(r"(?<= at )/\S+(?=,)", greeting)
        self.port = found[0] if found else f"udpout:127.0.0.1:{number}"

    def end(self) -> dict[str, Any]:
        """End it as Ctrl-C does and return its report."""
        self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=PATIENCE_S)
        assert self.process.returncode == 0, err.decode()
        report: dict[str, Any] = json.loads(out)
        return report

    def kill(self) -> None:
        """End it without a word, whatever its state."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def _greeting(self) -> str:
        """The first line on stderr."""
        assert self.process.stderr is not None
        text, until_s = b"", time.monotonic() + PATIENCE_S
        while b"\n" not in text:
            assert time.monotonic() < until_s, text
            if select.select([self.process.stderr], [], [], 0.2)[0]:
                data = os.read(self.process.stderr.fileno(), 4096)
                assert data, text.decode()
                text += data
        return text.decode()


@contextmanager
def board(*arguments: str, pty: bool = False) -> Iterator[BoardProcess]:
    """Run a board for a while."""
    running = BoardProcess(*arguments, pty=pty)
    try:
        yield running
    finally:
        running.kill()


class ScriptedBoard:
    """A board in this process: it beats, says where its servos are, and whatever else it is told to.

    Attributes:
        port: what to connect to.
        pulses_us: what it says of its channels, (18,).
        active: the mask that it says.
        kind: MAV_TYPE under which it shows itself.
        state: MAV_STATE of its heartbeat.
        extra: messages that it sends every period.
        silent: True to say nothing but heartbeats.
        heard: frames that came, newest last.
    """

    def __init__(self, *, signing_key: bytes | None = None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.01)
        self.port = f"udpout:127.0.0.1:{self._socket.getsockname()[1]}"
        self.pulses_us: FloatArray = np.full(18, 1500.0)
        self.active = 0x3FFFF
        self.kind, self.state = 0, mavlink_messages.ACTIVE
        self.extra: list[Any] = []
        self.silent = False
        self.heard: list[Frame] = []
        self._codec = Codec(1, 1, signing_key=signing_key)
        self._ears = Codec(1, 1, signing_key=signing_key)
        self._sequence = 0
        self._client: Any = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def say(self, message: Any) -> None:
        """Send one message now."""
        if self._client is not None:
            self._sequence += 1
            self._socket.sendto(self._codec.encode(message, self._sequence), self._client)

    def say_bytes(self, data: bytes) -> None:
        """Send bytes now."""
        self._socket.sendto(data, self._client)

    def overrides(self) -> list[list[int]]:
        """The channels of all overrides received."""
        return [
            mavlink_messages.channels_of(frame.message)
            for frame in list(self.heard)
            if frame.kind == "RC_CHANNELS_OVERRIDE"
        ]

    def _run(self) -> None:
        while not self._over.is_set():
            try:
                data, self._client = self._socket.recvfrom(2048)
                self.heard += self._ears.decode(data, whole=True)
            except TimeoutError:
                pass
            self.say(mavlink_messages.heartbeat(self.kind, 0, self.state))
            if not self.silent:
                mask = np.array([self.active >> channel & 1 for channel in range(18)], dtype=bool)
                self.say(board_messages.outputs(self.pulses_us, mask, 0.0))
                for message in list(self.extra):
                    self.say(message)


def eventually(condition: Any) -> None:
    """Wait until something is so."""
    wait_for(condition, PATIENCE_S, "the condition never became true", poll_s=0.005)


def stance_us(servo_map: ServoMap) -> FloatArray:
    return servo_map.to_us(shipped().stance_angles_rad)
