"""The twin: a simulated robot in real time that writes down what it truly does, and fails when it is told to.

It listens at a socket in the folder of its rig for words such as `wild 4 1.5`; `FAULTS` lists them.
"""

import os
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from faults.programs.truth import FAULT, STATE, TOLD, TruthWriter
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.robot.rotations import cos_tilt
from hexctl.types import N_JOINTS, JointTargets, RobotState, ServoReadings

#: Folder of the rig, for twins that other programs make.
FOLDER_VARIABLE = "FAULTS_FOLDER"

#: Files in that folder.
TRUTH, SOCKET = "truth", "twin.sock"

#: How far a body is tipped and lifted that falls: it lies on its side within a few control periods.
TIPPED_RAD, LIFTED_M = 1.4, 0.05

#: Temperature of the other servos, in degrees Celsius.
USUAL_C = 35.0

#: Seconds by which the wall's clock jumps.
JUMP_S = 86_400.0

#: Words, and their numbers.
FAULTS = {
    "wild": "JOINT RAD: one reading of a joint is off by that",
    "frozen": "JOINT: its encoder tells the same angle from now on",
    "hot": "JOINT DEGREES_C: its servo has that temperature",
    "limp": "LEG JOINT: a joint neither follows nor holds",
    "fall": "the body is tipped over",
    "jump": "`time.time` of this process jumps by a day",
}


class TwinServos(SimServos):
    """A simulated robot in real time, with faults, and a log of the truth.

    Args:
        robot: the robot.
        world: the world, flat unless given.
        seed: of everything random.
        folder: of the rig; that of the environment unless given.
        told: whether what is written to it is what servos are told; a board tells that itself.

    Attributes:
        truth: where it writes.
        others: called with words that are not the twin's, such as those of a board.
    """

    def __init__(
        self,
        robot: Robot | str | Path,
        *,
        world: World | str | Path | None = None,
        seed: int = 0,
        folder: Path | None = None,
        told: bool = True,
    ) -> None:
        super().__init__(robot, world=world, seed=seed, realtime=True)
        place = Path(os.environ[FOLDER_VARIABLE]) if folder is None else folder
        self.truth = TruthWriter(place / TRUTH)
        self.others: Callable[[str], None] = lambda _: None
        self._tells = told
        self._words = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with suppress(FileNotFoundError):
            (place / SOCKET).unlink()
        self._words.bind(str(place / SOCKET))
        self._words.setblocking(False)
        self._off_rad = np.zeros(N_JOINTS)
        self._wild_ticks = 0
        self._frozen_rad: dict[int, float] = {}
        self._hot_c: dict[int, float] = {}

    def write(self, targets: JointTargets) -> JointTargets:
        """Command the servos, and write it down."""
        sent = super().write(targets)
        if self._tells:
            self.truth.add(TOLD, targets.joint_positions_rad)
        return sent

    def read(self) -> RobotState:
        """State, with what faulty sensors tell."""
        state = super().read()
        joints = state.joint_positions_rad.copy()
        if self._wild_ticks:
            joints += self._off_rad
        for joint, angle_rad in self._frozen_rad.items():
            joints[joint] = angle_rad
        state = replace(state, joint_positions_rad=joints)
        return replace(state, servos=self._readings()) if self._hot_c else state

    def _step(self) -> None:
        super()._step()
        self._wild_ticks = max(0, self._wild_ticks - 1)
        with suppress(BlockingIOError):
            while True:
                self._begin_fault(self._words.recv(256).decode())
        data = self.compiled.physics.data.ptr
        _, x, y, _ = data.qpos[3:7].tolist()
        self.truth.add(STATE, data.qpos[7 : 7 + N_JOINTS], float(cos_tilt(x, y)))

    def _begin_fault(self, word: str) -> None:
        kind, *numbers = word.split()
        if kind == "wild":
            self._off_rad = np.zeros(N_JOINTS)
            self._off_rad[int(numbers[0])] = float(numbers[1])
            self._wild_ticks = 1
        elif kind == "frozen":
            joint = int(numbers[0])
            self._frozen_rad[joint] = float(super().read().joint_positions_rad[joint])
        elif kind == "hot":
            self._hot_c[int(numbers[0])] = float(numbers[1])
        elif kind == "limp":
            leg = int(numbers[0])
            self.change_leg(leg, parse_kind(leg, f"limp:{numbers[1]}"))
        elif kind == "fall":
            self._fall()
        elif kind == "jump":
            jump_clock()
        else:
            self.others(word)
        self.truth.add(FAULT)

    def _fall(self) -> None:
        data = self.compiled.physics.data.ptr
        data.qpos[2] += LIFTED_M
        data.qpos[3:7] = np.cos(TIPPED_RAD / 2), np.sin(TIPPED_RAD / 2), 0.0, 0.0
        data.qvel[:6] = 0.0

    def _readings(self) -> ServoReadings:
        unknown = np.full(N_JOINTS, np.nan)
        temperatures_c = np.full(N_JOINTS, USUAL_C)
        for joint, degrees_c in self._hot_c.items():
            temperatures_c[joint] = degrees_c
        return ServoReadings(
            ages_s=np.zeros(N_JOINTS),
            efforts=unknown,
            currents_a=unknown,
            voltages_v=unknown,
            temperatures_c=temperatures_c,
        )


def jump_clock() -> None:
    """Let the wall's clock of this process jump by a day, for everything that asks Python for the time."""
    wall_s, wall_ns = time.time, time.time_ns
    time.time = lambda: wall_s() + JUMP_S
    time.time_ns = lambda: wall_ns() + round(JUMP_S * 1e9)


def tell_twin(folder: Path, word: str) -> None:
    """Tell the twin of a rig to fail."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(word.encode(), str(folder / SOCKET))
