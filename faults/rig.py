"""A rig: a simulated robot, a board or bus before it, a server, a link and a controller, all as processes."""

import os
import random
import re
import signal
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from faults.backend import Backend
from faults.phase import Phase
from faults.process import LostError, Program, children_of, free_port
from faults.programs.truth import Truth
from faults.programs.twin import FOLDER_VARIABLE, TRUTH, tell_twin

TWIN = "faults.programs.twin:TwinServos"

#: A served robot that is left alone between two faults does not sit down meanwhile.
SIT_AFTER_S = 600

#: How long a motion goes on after the end of a fault before the next one may come.
SETTLES_S = 1.0


class Rig:
    """Processes of one backend, for one fault after another.

    Args:
        backend: of the robot.
        folder: for its files, empty.
        relayed: whether the link on which faults happen passes a relay.
        seed: of the relay.

    Attributes:
        folder: of its files.
        board: the process of board or bus, None without.
        server: the process that serves, None without.
        relay: the process of the relay, None without.
        controller: the process that commands, None before the first phase.
        endpoint: where the robot is served, empty without.
        device: port of board or bus, empty without.
        store: folder of the sessions of the newest trials.
    """

    def __init__(self, backend: Backend, folder: Path, *, relayed: bool = False, seed: int = 0) -> None:
        self.backend, self.folder = backend, folder
        self._relayed, self._seed = relayed, seed
        self.board: Program | None = None
        self.server: Program | None = None
        self.relay: Program | None = None
        self.controller: Program | None = None
        self.endpoint = self._link = self.device = ""
        self._trials = 0
        self._drives = False  # whether the controller is in a drive that may go on with another motion
        self._keepers: list[int] = []
        self._variables = {FOLDER_VARIABLE: str(folder)}
        self.store = folder

    def __enter__(self) -> Self:
        """Start all but the controller; raises LostError for what does not start."""
        try:
            self._start()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def begin(self, phase: Phase, chance: random.Random, *, record: bool) -> None:
        """Bring the robot into a phase, up to a moment by chance in it."""
        if phase.motion is None:
            self._begin_trials()
        else:
            self._drive(phase.motion, record=record)
        if phase.word is not None:
            time.sleep(chance.uniform(0.0, 0.6))
            assert self.controller is not None
            self.controller.tell(phase.word)
            self._drives = self._drives and phase.word != "sit"
        time.sleep(chance.uniform(*phase.wait_s))

    def check_ready(self, phase: Phase) -> None:
        """Raise LostError for a robot that has stopped, or lost a leg as it believes, before the fault."""
        if phase.motion is not None and self._said_last() != "ready":
            raise LostError(f"before the fault: {self._said_last() or 'the controller has gone'}")

    def end(self) -> None:
        """Let the controller end its drive, so that the next one may begin."""
        self._drives = False
        if self.controller is None or not self.controller.alive:
            self.controller = None
            return
        if self._trials:
            self._replace_controller()
            return
        if self._said_last().startswith(("ended", "done")) or not self._said_last():
            return
        since = len(self.controller.said())
        self.controller.tell("end")
        self.controller.wait_for("done", since, or_text="ended")

    def drop_controller(self) -> None:
        """End the controller as it is."""
        self._replace_controller()

    def truth(self, from_s: float) -> Truth:
        """What the robot truly did since a moment."""
        return Truth.read(self.folder / TRUTH, from_s)

    def tell_twin(self, word: str) -> float:
        """Let the twin fail; when it was told."""
        now_s = time.monotonic()
        tell_twin(self.folder, word)
        return now_s

    @property
    def robot_file(self) -> Path:
        """The robot file."""
        return self.folder / f"{self.backend.base}-{self.backend.name}.yaml"

    def _start(self) -> None:
        robot = str(self.backend.write_file(self.folder))
        self._variables |= self.backend.install(self.folder)
        if not self.backend.served:
            return
        device: tuple[str, ...] = ()
        name = TWIN
        if self.backend.boarded:
            name = self.backend.name
            self.board = self._program("board", "twin_board", name, robot, str(self.folder))
            place = self._found(self.board, r"board at (\S+)")
            if self._relayed and name == "mavlink":
                place = f"udpout:127.0.0.1:{self._relay_to(place.rpartition(':')[2], 'udp')}"
            device = ("--port", place)
            self.device = place
        port = free_port()
        self.endpoint = self._link = f"tcp/127.0.0.1:{port}"
        serve = ("hexctl", "serve", "--backend", name, "--robot", robot, "--listen", self.endpoint, *device)
        self.server = Program(
            self.folder,
            "server",
            *serve,
            "--sit-after",
            str(SIT_AFTER_S),
            **self._variables,
        )
        self.server.wait_for("serving")
        self._keepers = children_of(self.server.pid)
        if self._relayed and name == TWIN:
            self._link = f"tcp/127.0.0.1:{self._relay_to(str(port), 'tcp')}"

    def _relay_to(self, port: str, kind: str) -> str:
        self.relay = self._program("relay", "relay", kind, port, str(self._seed))
        return self._found(self.relay, r"relay at (\d+)")

    def _drive(self, motion: str, *, record: bool) -> None:
        going_on = self._drives and not record and self._said_last() == "ready"
        if not going_on:
            self.end()
        else:  # what the fault before has left behind is over, such as what a bus remembers of lost answers
            time.sleep(SETTLES_S)
        if self.controller is None or not self.controller.alive:
            place = self._link or "-"
            name = "zenoh" if self.backend.served else "sim"
            words = ("controller", name, place, str(self.robot_file), str(self.folder))
            self.controller = self._program("controller", *words)
        since = len(self.controller.said())
        self.controller.tell(f"{'again' if going_on else 'go'} {motion}{' record' if record else ''}")
        self.controller.wait_for("ready", since, but="ended")
        self._drives = not record

    def _said_last(self) -> str:
        """Last line of the controller; empty without one that runs."""
        if self.controller is None or not self.controller.alive:
            return ""
        return (self.controller.said().splitlines() or [""])[-1]

    def _begin_trials(self) -> None:
        self._replace_controller()
        self._trials += 1
        self.store = self.folder / f"trials-{time.monotonic_ns()}"
        self.store.mkdir()
        words = ("trials", self._link, str(self.robot_file), str(self.store))
        self.controller = self._program("trials", *words)
        self.controller.wait_for("placing 2", but="ended")

    def _replace_controller(self) -> None:
        if self.controller is not None:
            self.controller.end()
        self.controller, self._trials, self._drives = None, 0, False

    def _program(self, name: str, module: str, *arguments: str) -> Program:
        return Program(
            self.folder,
            name,
            f"faults.programs.{module}",
            *arguments,
            **self._variables,
        )

    def _found(self, program: Program, pattern: str) -> str:
        program.wait_for(" at ")
        found = re.search(pattern, program.said())
        if found is None:
            raise LostError(f"{program.name}: {program.said()}")
        return found[1]

    def _end(self) -> None:
        self._replace_controller()
        for program in (self.relay, self.server, self.board):
            if program is not None:
                program.end(softly=program is not self.relay)
        self.relay = self.server = self.board = None
        # A keeper outlives its server, and would open the port of the next rig where it has the same name.
        for keeper in self._keepers:
            with suppress(ProcessLookupError):
                os.kill(keeper, signal.SIGKILL)
        self._keepers = []
