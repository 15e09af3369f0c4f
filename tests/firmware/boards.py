"""The sketch in `firmware/`, compiled for this computer: on simulated time, and with simulated chips."""

import atexit
import ctypes
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

import numpy as np
import pytest

from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.robot.servos.servo_map import ServoMap
from hexctl.types import FloatArray
from tests.backends.fake_time import FakeTime
from tests.backends.mavlink.boards import MemoryPort, memory_board
from tests.robots import shipped

SKETCH = Path(__file__).parents[2] / "firmware" / "hexapod"
HERE = Path(__file__).parent

ARCHITECTURES = "ESP32", "RP2040"

#: The wire of OE, by architecture, and in tests also an input of the battery and foot switches.
PIN_OE = {"ESP32": 23, "RP2040": 6}
PIN_BATTERY, PINS_FEET = 34, (40, 41, 42, 43, 44, 45)

#: Names of the counters, in their order.
COUNTERS = [
    *("overrides", "refused", "of_others", "not_yet", "expired", "released"),
    *("clipped", "lost", "out_of_order", "crowded_out", "malformed", "dropped"),
]

#: How long the program waits for bytes before it looks at its clock again.
PASS_S = 0.005


@cache
def sketch_with_headers() -> Path:
    """A copy of the sketch with the headers that its README has an owner generate."""
    compiler = shutil.which("g++")
    if compiler is None:
        missing = "g++ compiles the firmware for its tests: apt-get install g++"
        (pytest.fail if os.environ.get("HEXCTL_REQUIRE_ALL") else pytest.skip)(missing)
    folder = Path(mkdtemp(prefix="hexctl-firmware-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    sketch = folder / SKETCH.name
    shutil.copytree(SKETCH, sketch, ignore=shutil.ignore_patterns("mavlink"))
    messages = Path(str(files("pymavlink"))) / "dialects" / "v20" / "common.xml"
    generator = sys.executable, "-m", "pymavlink.tools.mavgen"
    _run(*generator, "--lang", "C", "--wire-protocol", "2.0", "-o", sketch / "src" / "mavlink", messages)
    return sketch


def compiled(
    output: Path,
    source: Path,
    *options: str,
    architecture: str = "RP2040",
    feet: Sequence[int] = PINS_FEET,
) -> Path:
    """A program or library of a source and the sketch."""
    sketch = sketch_with_headers()
    pins = f"-DPINS_FEET={{{','.join(map(str, feet))}}}"
    defined = f"-DARDUINO_ARCH_{architecture}", f"-DPIN_BATTERY={PIN_BATTERY}", pins
    # The generated headers are not ours to warn about.
    include = f"-I{sketch}", f"-I{HERE / 'arduino'}", "-isystem", sketch / "src" / "mavlink"
    warnings = "-Wall", "-Wextra", "-Werror", "-Wno-address-of-packed-member", "-Wno-unused-function"
    language = "-std=c++11", "-x", "c++"
    sources = source, sketch / "board.cpp"
    _run("g++", *language, "-O0", *warnings, *defined, *include, *options, *sources, "-o", output)
    return output


@cache
def library(architecture: str, feet: tuple[int, ...]) -> bytes:
    """The sketch as a shared library for a kind of board, with pins of foot switches."""
    with TemporaryDirectory() as folder:
        path, shared = Path(folder) / "firmware.so", ("-shared", "-fPIC")
        return compiled(
            path, HERE / "computer.cpp", *shared, architecture=architecture, feet=feet
        ).read_bytes()


def _run(*command: str | Path) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]


class Firmware:
    """One board with the sketch: it gets bytes and the time, and has two PCA9685.

    Args:
        start_us: pulses reported before the first command, (18,).
        limits_us: shortest and longest pulse of each channel; those of `config.h` without any.
        feet: pins of the foot switches; -1 is none.
    """

    def __init__(
        self,
        start_us: Sequence[float] | FloatArray,
        *,
        expiry_s: float = 0.2,
        release_after_s: float = 10.0,
        signing_key: bytes | None = None,
        limits_us: Sequence[tuple[int, int]] = (),
        architecture: str = "RP2040",
        feet: tuple[int, ...] = PINS_FEET,
    ) -> None:
        self.pin_oe = PIN_OE[architecture]
        with TemporaryDirectory() as folder:
            # A copy for each board, because a library is loaded once and has its state in globals.
            path = Path(folder) / "firmware.so"
            path.write_bytes(library(architecture, feet))
            self._code = ctypes.CDLL(str(path))
        self._code.take.restype = ctypes.c_size_t
        self._code.registers.restype = ctypes.POINTER(ctypes.c_uint8)
        self._frame = ctypes.create_string_buffer(512)
        start = (ctypes.c_uint16 * 18)(*(round(float(pulse)) for pulse in start_us))
        times = (ctypes.c_uint32(round(each * 1e6)) for each in (expiry_s, release_after_s))
        self._code.configure(start, *times, signing_key)
        for channel, (least, most) in enumerate(limits_us):
            self._code.limit(channel, least, most)

    def begin(self, now_s: float) -> None:
        """Switch it on."""
        self._code.begin(ctypes.c_uint64(round(now_s * 1e6)))

    def run(self, now_s: float, data: bytes = b"") -> list[bytes]:
        """Let the program run once, with bytes that have come, and return the frames that it sends."""
        self._code.pass_once(data, ctypes.c_size_t(len(data)), ctypes.c_uint64(round(now_s * 1e6)))
        frames = []
        while length := self._code.take(self._frame):
            frames.append(self._frame.raw[:length])
        return frames

    def counts(self) -> dict[str, int]:
        """Its counters."""
        counts = (ctypes.c_uint32 * len(COUNTERS))()
        self._code.count(counts)
        return dict(zip(COUNTERS, counts, strict=True))

    def chip(self, number: int) -> bytes:
        """Registers of a PCA9685, 0 or 1."""
        return bytes(self._code.registers(number)[:256])

    def pulses_us(self) -> FloatArray:
        """Pulses at its servos, (18,), as its chips make them; 0 is none."""
        if self._code.level(self.pin_oe):
            return np.zeros(18)
        return np.array([_pulse_us(self.chip(servo // 9), servo % 9) for servo in range(18)])

    def __getattr__(self, name: str) -> Any:
        """Functions of `computer.cpp`."""
        return getattr(self._code, name)


def _pulse_us(registers: bytes, channel: int) -> float:
    on_low, on_high, off_low, off_high = registers[6 + 4 * channel : 10 + 4 * channel]
    assert on_low == on_high == 0
    tick_us = (registers[0xFE] + 1) / 25.0
    asleep = registers[0] & 0x10
    assert off_low or off_high, "without counts and the bit for off, the data sheet promises nothing"
    return 0.0 if asleep or off_high & 0x10 else (off_low + 256 * (off_high & 0x0F)) * tick_us


@dataclass
class FirmwareBoard:
    """The sketch in a thread on simulated time, at a port in memory."""

    port: MemoryPort
    servo_map: ServoMap
    firmware: Firmware
    stopping: threading.Event = field(default_factory=threading.Event)

    @property
    def time(self) -> FakeTime:
        """Of everything on it."""
        return self.port.time

    def run(self) -> None:
        """Serve the port until the end."""
        self.firmware.begin(self.time.now())
        while not self.stopping.is_set():
            for data, _ in self.port.receive(PASS_S) or [(b"", None)]:
                for frame in self.firmware.run(self.time.now(), data):
                    for address in list(self.port.others):
                        self.port.send(frame, address)

    def end(self) -> dict[str, Any]:
        """Let it end and return its counters."""
        self.stopping.set()
        self.time.sleep(0.1)
        return self.firmware.counts()


@contextmanager
def firmware_board(servo_map: ServoMap, **options: Any) -> Iterator[FirmwareBoard]:
    """Run a board in memory meanwhile, with options of `Firmware`."""
    firmware = Firmware(servo_map.to_us(shipped().stance_angles_rad), **options)
    running = FirmwareBoard(MemoryPort(FakeTime()), servo_map, firmware)
    thread = threading.Thread(target=running.run)
    thread.start()
    try:
        running.time.sleep(0.05)
        yield running
    finally:
        running.stopping.set()
        running.time.join(thread)


#: Both ends of the contract: the simulated board, and the sketch.
BOARDS = [
    pytest.param(memory_board, id="simulated"),
    pytest.param(firmware_board, id="firmware", marks=pytest.mark.slow),
]


def decoded(frames: list[bytes], kind: str) -> list[Any]:
    """Messages of a kind in frames."""
    codec = Codec(255, 191)
    found: list[Frame] = [frame for data in frames for frame in codec.decode(data, whole=True)]
    return [frame.message for frame in found if frame.kind == kind]
