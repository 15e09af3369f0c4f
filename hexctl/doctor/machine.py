"""The computer itself: system, processor, memory, disk, timing, and what draws without a screen."""

import os
import platform
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from hexctl.backends.clock import PERIOD_S, request_realtime_priority
from hexctl.export.render import RENDERERS
from hexctl.recording.viewer import has_display
from hexctl.settings import shown_path

#: Control periods of the timing measurement.
MEASURED_TICKS = 25

#: Size of a recording of a walk of 30 s, for the disk.
WALK_MB = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A computer.

    Attributes:
        cores: available to this process.
        load: mean of the last minute, or None.
        memory_mb: free and total, or None.
        disk_free_mb: on the disk of the folder for runs.
        late_ms: maximum lateness of some ticks of 20 ms.
    """

    system: str
    architecture: str
    python: str
    processor: str
    cores: int
    load: float | None
    governor: str | None
    memory_mb: tuple[int, int] | None
    disk_free_mb: int
    folder_writable: bool
    realtime: bool
    late_ms: float


def read_machine(folder: Path) -> Machine:
    """The computer, and the disk of a folder, which need not exist."""
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.is_dir())
    realtime, late_ms = _punctuality()
    return Machine(
        system=_system(),
        architecture=platform.machine(),
        python=f"{platform.python_version()} ({shown_path(Path(sys.executable))})",
        processor=_processor(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        load=round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        governor=_text(Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")),
        memory_mb=_memory_mb(),
        disk_free_mb=shutil.disk_usage(existing).free // 2**20,
        folder_writable=os.access(existing, os.W_OK),
        realtime=realtime,
        late_ms=late_ms,
    )


def _system() -> str:
    try:
        name = platform.freedesktop_os_release().get("PRETTY_NAME", platform.system())
    except OSError:
        name = platform.system()
    return f"{name}, kernel {platform.release()}"


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        return None


def _fields(path: Path) -> dict[str, str]:
    """Values of lines such as `MemTotal:  100 kB`, the first of each name."""
    found: dict[str, str] = {}
    for line in (_text(path) or "").splitlines():
        name, colon, value = line.partition(":")
        if colon:
            found.setdefault(name.strip(), value.strip())
    return found


def _processor() -> str:
    fields = _fields(Path("/proc/cpuinfo"))
    return fields.get("model name") or fields.get("Model") or platform.processor() or "unknown"


def _memory_mb() -> tuple[int, int] | None:
    fields = _fields(Path("/proc/meminfo"))
    try:
        free, total = (int(fields[name].split()[0]) // 1024 for name in ("MemAvailable", "MemTotal"))
    except (KeyError, ValueError):
        return None
    return free, total


def _punctuality() -> tuple[bool, float]:
    """Whether a temporary thread gets real-time priority, and its maximum lateness in ms."""
    found: list[tuple[bool, float]] = []

    def measure() -> None:
        granted, worst_s, begin_s = request_realtime_priority(), 0.0, time.monotonic()
        for tick in range(1, MEASURED_TICKS + 1):
            due_s = begin_s + tick * PERIOD_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            worst_s = max(worst_s, time.monotonic() - due_s)
        found.append((granted, round(1e3 * worst_s, 2)))

    thread = threading.Thread(target=measure)
    thread.start()
    thread.join()
    return found[0]


#: Maximum time of a graphics library's answer.
TIMEOUT_S = 30.0

#: A separate program: a broken graphics library may kill its process.
PROGRAM = """
import os, sys
os.environ["MUJOCO_GL"] = sys.argv[1]
from hexctl.export.render import open_context
context = open_context(16, 16)
from OpenGL import GL
print(GL.glGetString(GL.GL_RENDERER).decode())
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """Available renderers: name by `egl` and `osmesa`, or None; and whether there is a screen."""

    renderers: dict[str, str | None]
    display: bool

    @property
    def draws(self) -> bool:
        """Whether it can draw without a screen."""
        return any(name is not None for name in self.renderers.values())


def read_drawing() -> Drawing:
    """Renderers of this computer."""
    return Drawing(
        renderers={name: _renderer(name) for name in RENDERERS},
        display=has_display(),
    )


def _renderer(name: str) -> str | None:
    """Name of a library's renderer from a separate process, or None."""
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", PROGRAM, name],  # -P: no module of the working folder
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    lines = done.stdout.strip().splitlines()
    return lines[-1] if lines else None
