"""How a fault is made to happen in a rig."""

import os
import resource
import signal
import threading
import time
from collections.abc import Callable
from typing import Self

from faults.fault import Fault
from faults.process import LostError, Program
from faults.rig import Rig

#: The joint that fails: the femur of leg 2; how far its one wild reading is off; how hot its servo gets.
LEG, KIND, JOINT = 2, "femur", 4
WILD_RAD, HOT_C = 1.5, 72.0

#: Shares and times by the end of a fault's name.
GARBLED = 0.05
REORDERED = 0.2

#: A process that was to be frozen for a time and was for this much longer was held up by the machine.
LATE_S = 0.015

#: Sleep of a thread whose lateness is measured.
NAP_S = 0.005


class TooLateError(Exception):
    """The machine was too busy to make a fault as it was meant."""


class Injection:
    """A fault in a rig, once.

    Args:
        rig: in which it happens.
        fault: which.
    """

    def __init__(self, rig: Rig, fault: Fault) -> None:
        self._rig, self._fault = rig, fault
        self._bystander: Program | None = None

    def prepare(self) -> None:
        """Start what it needs besides, before the robot moves."""
        name, rig = self._fault.name, self._rig
        if name.startswith("viewer"):
            self._bystander = Program(rig.folder, "viewer", "faults.programs.viewer", rig.endpoint)
            self._bystander.wait_for("looking")
        elif name == "flood":
            place = rig.endpoint
            if rig.backend.name == "mavlink":
                place = f"udp/127.0.0.1:{rig.device.rpartition(':')[2]}"
            words = ("faults.programs.flood", place, str(rig.robot_file))
            self._bystander = Program(rig.folder, "flood", *words)
            self._bystander.wait_for("ready")

    def begin(self) -> float:
        """Let it happen, and be over where it is one that passes; when it began, on time.monotonic.

        Raises TooLateError where the machine kept it from being what it is meant to be.
        """
        name = self._fault.name
        if name == "none":
            return time.monotonic()
        for beginning, make in self._kinds().items():
            if name.startswith(beginning):
                return make()
        raise LostError(f"no injection of {name}")

    def end(self) -> None:
        """Undo what is not over, where it can be undone."""
        if self._bystander is not None:
            self._bystander.end()
        lossy, garbled = self._fault.name.startswith("loss"), self._fault.name == "garbled"
        if self._rig.relay is not None:
            self._rig.relay.tell("clear")
        elif (lossy or garbled) and self._rig.backend.boarded:
            self._rig.tell_twin(self._lossy_word(0) if lossy else f"{self._rig.backend.garbling}:0")

    def _kinds(self) -> dict[str, Callable[[], float]]:
        """What makes a fault, by the beginning of its name, the longer ones first."""
        return {
            "controller-killed": self._kill_controller,
            "frozen-encoder": self._freeze_encoder,
            "frozen-": self._freeze_controller,
            "server-killed": self._kill_server,
            "server-frozen": self._freeze_server,
            "cable-out": self._cut,
            "loss-": self._lose,
            "reorder": self._reorder,
            "delay-": self._delay,
            "garbled": self._garble,
            "clock-jump": self._jump,
            "mute-servo": self._mute,
            "brown-out": self._brown_out,
            "wild-reading": self._wild,
            "hot-servo": self._heat,
            "fallen": self._fall,
            "full-disk": self._fill_disk,
            "viewer-": self._lose_viewer,
            "flood": self._flood,
        }

    @property
    def _controller(self) -> Program:
        if self._rig.controller is None or not self._rig.controller.alive:
            raise LostError("the controller has gone before the fault")
        return self._rig.controller

    @property
    def _server(self) -> Program:
        if self._rig.server is None or not self._rig.server.alive:
            raise LostError("the server has gone before the fault")
        return self._rig.server

    def _kill_controller(self) -> float:
        return self._controller.signal(signal.SIGKILL)

    def _freeze_controller(self) -> float:
        at_s = self._controller.signal(signal.SIGSTOP)
        time.sleep(self._fault.lasts_s)
        over_s = self._controller.signal(signal.SIGCONT)
        if self._fault.lasts_s < 0.2 and over_s - at_s > self._fault.lasts_s + LATE_S:
            raise TooLateError(f"frozen for {over_s - at_s:.3f} s")
        return at_s

    def _kill_server(self) -> float:
        return self._server.signal(signal.SIGKILL)

    def _freeze_server(self) -> float:
        return self._server.signal(signal.SIGSTOP)

    def _cut(self) -> float:
        if self._rig.relay is None:
            return self._rig.tell_twin("unplug")
        self._rig.relay.tell("cut")
        return time.monotonic()

    def _lose(self) -> float:
        share = float(self._fault.name.partition("-")[2]) / 100
        if self._rig.relay is None:
            return self._rig.tell_twin(self._lossy_word(share))
        self._rig.relay.tell(f"loss {share}")
        return time.monotonic()

    def _lossy_word(self, share: float) -> str:
        """Word for a share of packets that get lost; an I2C bus loses none unnoticed."""
        return f"nack:{share}" if "nack" in self._rig.backend.kinds else f"loss {share}"

    def _reorder(self) -> float:
        assert self._rig.relay is not None
        self._rig.relay.tell(f"reorder {REORDERED}")
        return time.monotonic()

    def _delay(self) -> float:
        assert self._rig.relay is not None
        self._rig.relay.tell(f"delay {self._fault.name.partition('-')[2]}")
        return time.monotonic()

    def _garble(self) -> float:
        if self._rig.relay is not None:
            self._rig.relay.tell(f"garble {GARBLED}")
            return time.monotonic()
        return self._rig.tell_twin(f"{self._rig.backend.garbling}:{GARBLED}")

    def _jump(self) -> float:
        """In the controller, and in the process of the twin, which is the server where it is served."""
        if self._rig.backend.served:
            self._controller.tell("jump")
        return self._rig.tell_twin("jump")

    def _mute(self) -> float:
        bus = self._rig.backend.serial_bus
        return self._rig.tell_twin(f"mute:{LEG}:{KIND}" if bus else f"limp {LEG} {KIND}")

    def _brown_out(self) -> float:
        return self._rig.tell_twin("reset" if "reset" in self._rig.backend.kinds else "brown-out")

    def _freeze_encoder(self) -> float:
        return self._rig.tell_twin(f"frozen {JOINT}")

    def _wild(self) -> float:
        return self._rig.tell_twin(
            "wild-once" if self._rig.backend.serial_bus else f"wild {JOINT} {WILD_RAD}"
        )

    def _heat(self) -> float:
        bus = self._rig.backend.serial_bus
        return self._rig.tell_twin(f"hot:{LEG}:{KIND}:{HOT_C:g}" if bus else f"hot {JOINT} {HOT_C:g}")

    def _fall(self) -> float:
        return self._rig.tell_twin("fall")

    def _fill_disk(self) -> float:
        """Nothing may grow from now on: what writes gets EFBIG, as a full disk gives ENOSPC."""
        for program in (self._rig.controller, self._rig.server):
            if program is not None:
                # Programs open new files too, which may have no byte.
                resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
        return time.monotonic()

    def _lose_viewer(self) -> float:
        assert self._bystander is not None
        return self._bystander.signal(
            signal.SIGKILL if self._fault.name == "viewer-killed" else signal.SIGSTOP
        )

    def _flood(self) -> float:
        assert self._bystander is not None
        self._bystander.tell("now")
        return time.monotonic()


class LongestWait:
    """Measures how late threads without real-time priority wake up, one on each processor; a context manager.

    The threads of a link have no such priority: real-time loops on the same processor may delay them.

    Attributes:
        longest_s: maximum lateness so far.
    """

    def __init__(self) -> None:
        self.longest_s = 0.0
        self._over = threading.Event()
        processors = os.sched_getaffinity(0)
        self._threads = [
            threading.Thread(target=self._wake, args=(each,), daemon=True) for each in processors
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()

    def _wake(self, processor: int) -> None:
        os.sched_setaffinity(0, {processor})
        before_s = time.monotonic()
        while not self._over.is_set():
            time.sleep(NAP_S)
            now_s = time.monotonic()
            self.longest_s = max(self.longest_s, now_s - before_s - NAP_S)
            before_s = now_s


class Punctual:
    """Real-time priority of this thread while a fault is made, where the system grants it."""

    def __enter__(self) -> None:
        self._set(os.SCHED_FIFO, 20)

    def __exit__(self, *_: object) -> None:
        self._set(os.SCHED_OTHER, 0)

    def _set(self, policy: int, priority: int) -> None:
        try:
            os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        except OSError:
            return
