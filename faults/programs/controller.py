"""A controller of a rig: `python -m faults.programs.controller BACKEND PLACE ROBOT FOLDER`.

BACKEND is `zenoh`, to a robot served at PLACE, or `sim`, a twin in this process. Takes lines on stdin:
`go walking` (or `turning`, `standing`), then `again walking`, `release`, `sit`, `jump`, `end`; says `ready`
once the motion goes on, `halted: ...` of a robot that stopped by itself or believes that a leg has failed,
and `ended: ...` for what ends the drive. `go walking record` records meanwhile.
"""

import os
import select
import sys
import threading
import time
from pathlib import Path

from faults.programs.twin import TwinServos, jump_clock
from hexctl.backends.clock import realtime_priority
from hexctl.control.drive.drive import Drive
from hexctl.control.log import Recorders
from hexctl.errors import HexctlError

#: Shares of the greatest speed, forward and in turn, by motion.
SHARES = {"standing": (0.0, 0.0), "walking": (0.8, 0.0), "turning": (0.0, 0.8)}

#: Steps of a motion before it counts as going on: more than the robot takes to its full speed.
STEPS = 60


def say(text: str) -> None:
    """Print a line now."""
    os.write(1, f"{text}\n".encode())


class Lines:
    """Lines on stdin, as they come."""

    def __init__(self) -> None:
        self._waiting = b""

    def next(self, timeout_s: float | None = 0.0) -> str | None:
        """Next line, None without one in time; `quit` where the input has ended."""
        while b"\n" not in self._waiting:
            if not select.select([0], [], [], timeout_s)[0]:
                return None
            data = os.read(0, 4096)
            if not data:
                return "quit"
            self._waiting += data
        line, _, self._waiting = self._waiting.partition(b"\n")
        return line.decode()


def made_drive(backend: str, place: str, robot: str, folder: Path, *, record: bool) -> Drive:
    """A drive of the robot, recorded where that is wanted."""
    recorders = None
    if record:
        from hexctl import Recording, TrialPlan, load_robot, make_gait

        model = load_robot(robot)
        plan = TrialPlan(gait=make_gait(model, "tripod"), travel=0)
        path = folder / f"drive-{time.monotonic_ns()}.rrd"
        recorders = Recorders(Recording(path, model, plan, title="a drive of the fault matrix"))
    if backend == "sim":
        return Drive(servos=TwinServos(robot, folder=folder), recorders=recorders)
    return Drive(robot, backend="zenoh", connect=place, recorders=recorders)


def begin(drive: Drive, motion: str) -> None:
    """Command a motion, by its name."""
    forward, turn = SHARES[motion]
    velocity = drive.share(forward=forward, turn=turn)
    drive.command(velocity.forward_m_s, velocity.left_m_s, velocity.turn_rad_s)


def _trouble(drive: Drive) -> str:
    """Why it no longer does what it is told, or not with all legs; empty where it does."""
    if drive.stopped is not None:
        return f"the drive stopped: {drive.stopped}"
    return ", ".join(f"leg {failure.leg} is believed to have failed" for failure in drive.failures)


def drive(drive: Drive, motion: str, lines: Lines) -> bool:
    """Drive until told to end; whether to go on afterwards. Raises what the drive raises."""
    with drive, realtime_priority():
        drive.reset()
        begin(drive, motion)
        step, said = 0, ""
        while True:
            drive.step()
            step += 1
            if step == STEPS:
                say("ready")
            if (trouble := _trouble(drive)) and trouble != said:
                said = trouble
                say(f"halted: {said}")
            line = lines.next()
            if line == f"again {motion}":  # it goes on, and is at its speed
                say("ready")
            elif line is not None and line.startswith("again "):
                motion, step = line.partition(" ")[2], 0
                begin(drive, motion)
            elif line == "release":
                motion = "standing"
                begin(drive, motion)
            elif line == "sit":
                drive.sit()
            elif line == "jump":
                jump_clock()
            elif line in ("end", "quit"):
                return line == "end"


def main(backend: str, place: str, robot: str, folder: str) -> None:
    """Drive as often as told."""
    lines = Lines()
    threading.current_thread().name = "controller"
    while (line := lines.next(None)) not in (None, "quit"):
        words = (line or "").split()
        if words[:1] != ["go"]:
            continue  # for a drive that has ended
        try:
            made = made_drive(backend, place, robot, Path(folder), record="record" in words)
            if not drive(made, words[1], lines):
                return
            say("done")
        except HexctlError as error:
            say(f"ended: {type(error).__name__}: {error}")


if __name__ == "__main__":
    main(*sys.argv[1:])
