"""One injection: a robot is brought into a phase, a fault happens, and what becomes of it is measured."""

import random
import re
import time
from dataclasses import replace

from faults.fault import FAULTS, Fault
from faults.injection import Injection, LongestWait, Punctual
from faults.measurement import (
    Outcome,
    fell_after,
    goes_on,
    largest_steps,
    late_s,
    rest_after_s,
    told_after_s,
)
from faults.phase import PHASES
from faults.process import Program
from faults.rig import Rig
from hexctl.adapt.sessions.store import list_sessions
from hexctl.robot.loader import load_robot_file

#: How long a robot is watched after a fault is over.
WATCHED_S = 1.5

#: What is looked at before the fault, for the step across it.
BEFORE_S = 0.5

#: How long a trial takes at most that goes on after the robot was placed.
TRIAL_S = 6.0

#: What is said of a search that neither goes on nor ends.
NO_NEXT_TRIAL = "the next trial did not come"


def inject(rig: Rig, fault: Fault, phase: str, repetition: int) -> Outcome:
    """Outcome of a fault in a phase.

    Raises LostError where the rig fails before the fault, TooLateError where the machine is too busy.
    """
    chance = random.Random(f"{fault.name} {rig.backend.name} {phase} {repetition}")
    injection = Injection(rig, fault)
    try:
        injection.prepare()
        rig.begin(PHASES[phase], chance, record=fault.records and PHASES[phase].motion is not None)
        rig.check_ready(PHASES[phase])
        heard = {program: len(program.said()) for program in (rig.server, rig.controller) if program}
        with LongestWait() as wait:
            with Punctual():
                at_s = injection.begin()
            until_s = at_s + fault.lasts_s + WATCHED_S
            time.sleep(max(0.0, until_s - time.monotonic()))
        outcome = _measured(rig, at_s, heard, fault, phase, repetition)
    finally:
        injection.end()
    return replace(outcome, waited_s=round(wait.longest_s, 4))


def _measured(
    rig: Rig, at_s: float, heard: dict[Program, int], fault: Fault, phase: str, repetition: int
) -> Outcome:
    truth = rig.truth(at_s - BEFORE_S)
    # A twin that was told fails at its next control period.
    began_s = float(truth.fault_at_s[-1]) if truth.fault_at_s.size else at_s
    speeds_rad_s = load_robot_file(rig.robot_file).robot.joint_max_speed_rad_s
    step, pace = largest_steps(truth, began_s, speeds_rad_s, continuous=rig.backend.moves_take_time)
    trials, lost, came = _trials(rig, fault) if PHASES[phase].motion is None else (None, None, True)
    server = "" if rig.server is None else rig.server.said(heard[rig.server])
    controller = "" if rig.controller is None else rig.controller.said(heard[rig.controller])
    ended = re.search(r"^(?:ended|halted): (.*)$", controller, re.MULTILINE)
    return Outcome(
        fault=fault.name,
        backend=rig.backend.name,
        phase=phase,
        repetition=repetition,
        rest_s=_rounded(rest_after_s(truth, began_s)),
        told_s=round(told_after_s(truth, began_s), 4),
        step=round(step, 3),
        pace=round(pace, 3),
        fell=fell_after(truth, began_s),
        stops=tuple(re.findall(r"STOPPED: (.*)", server)),
        ended=ended[1][:200] if ended else _gone(rig, fault) or ("" if came else NO_NEXT_TRIAL),
        trials=trials,
        lost=lost,
        goes_on=goes_on(truth),
        late_s=round(late_s(truth, began_s), 4),
    )


def _gone(rig: Rig, fault: Fault) -> str:
    """What is said of programs that end without a word."""
    if fault.name in ("controller-killed", "server-killed"):
        return ""
    gone = [program.name for program in (rig.controller, rig.server) if program and not program.alive]
    over = [program.name for program in (rig.controller,) if program and "done" in program.said()]
    return ", ".join(f"{name} ended" for name in gone if name not in over)


def _trials(rig: Rig, fault: Fault) -> tuple[int, int, bool]:
    """Trials that were said to be stored, how many of them the store lacks, and whether the next one came.

    It is waited for where it is safe to go on.
    """
    program = rig.controller
    assert program is not None
    awaited = FAULTS[fault.name].safe == "goes on"
    if awaited:
        until_s = time.monotonic() + TRIAL_S
        while program.alive and "stored 2" not in program.said() and time.monotonic() < until_s:
            if "ended" in program.said():
                break
            time.sleep(0.05)
    said = len(re.findall(r"^stored \d+$", program.said(), re.MULTILINE))
    (session,) = list_sessions(rig.store)
    stored = len(session.trials)
    return said, max(0, said - stored), not awaited or said > 1


def _rounded(value_s: float | None) -> float | None:
    return None if value_s is None else round(value_s, 4)
