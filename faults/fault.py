"""Faults of the matrix: what fails, and what a robot does that is safe."""

from dataclasses import dataclass
from typing import Literal

#: What is safe: `rests` at once, `goes on` without a stop, or `either` of them; never a jump.
Reaction = Literal["rests", "goes on", "either"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One row of the matrix.

    Attributes:
        name: as `--only` takes it.
        words: what happens.
        safe: reaction that is safe while the robot moves.
        lasts_s: how long it lasts; the robot is watched for that much longer.
        relayed: whether it happens on a link, which then passes a relay.
        breaks: what has to be replaced afterwards: the `controller`, the whole `rig`, or `nothing`.
        records: whether the drive is recorded meanwhile.
        detected: whether the robot has to find out about it first, which counts as time to rest.
        topples: whether it makes the body fall by itself.
    """

    name: str
    words: str
    safe: Reaction
    lasts_s: float = 0.0
    relayed: bool = False
    breaks: Literal["nothing", "controller", "rig"] = "nothing"
    records: bool = False
    detected: bool = False
    topples: bool = False


NONE = "none"

FAULTS = {
    fault.name: fault
    for fault in (
        Fault(name=NONE, words="nothing fails", safe="goes on"),
        Fault(name="controller-killed", words="controller killed", safe="rests", breaks="controller"),
        Fault(name="frozen-0.15", words="controller frozen for 0.15 s", safe="goes on", lasts_s=0.15),
        Fault(
            name="frozen-0.3",
            words="controller frozen for 0.3 s",
            safe="rests",
            lasts_s=0.3,
            breaks="controller",
        ),
        Fault(
            name="frozen-5", words="controller frozen for 5 s", safe="rests", lasts_s=5.0, breaks="controller"
        ),
        Fault(name="server-killed", words="server killed", safe="rests", breaks="rig"),
        Fault(name="server-frozen", words="server frozen", safe="rests", breaks="rig"),
        Fault(name="cable-out", words="cable pulled out", safe="rests", relayed=True, breaks="rig"),
        Fault(name="loss-10", words="10 % of the messages lost", safe="goes on", lasts_s=1.0, relayed=True),
        Fault(name="loss-30", words="30 % of the messages lost", safe="goes on", lasts_s=1.0, relayed=True),
        Fault(
            name="reorder", words="20 % of the messages overtaken", safe="goes on", lasts_s=1.0, relayed=True
        ),
        Fault(name="delay-0.05", words="messages 0.05 s late", safe="goes on", lasts_s=1.0, relayed=True),
        Fault(
            name="delay-0.3",
            words="messages 0.3 s late",
            safe="rests",
            lasts_s=1.0,
            relayed=True,
            breaks="rig",
        ),
        Fault(name="clock-jump", words="the clock jumps by a day", safe="goes on"),
        Fault(name="mute-servo", words="a servo is dead", safe="either", breaks="rig", detected=True),
        Fault(name="garbled", words="5 % of the messages garbled", safe="goes on", lasts_s=1.0, relayed=True),
        Fault(
            name="brown-out",
            words="servos lose their supply",
            safe="either",
            breaks="rig",
            detected=True,
            topples=True,
        ),
        Fault(
            name="frozen-encoder", words="an encoder is frozen", safe="either", breaks="rig", detected=True
        ),
        Fault(name="wild-reading", words="one wild reading", safe="goes on"),
        Fault(name="hot-servo", words="a servo gets too hot", safe="either", breaks="rig", detected=True),
        Fault(
            name="fallen", words="the robot falls", safe="rests", breaks="rig", detected=True, topples=True
        ),
        Fault(name="full-disk", words="the disk is full", safe="goes on", records=True, breaks="rig"),
        Fault(name="viewer-killed", words="a viewer is killed", safe="goes on"),
        Fault(name="viewer-frozen", words="a viewer is frozen", safe="goes on", lasts_s=1.0),
        Fault(name="flood", words="up to 2000 foreign commands a second", safe="goes on", lasts_s=1.0),
    )
}

#: Faults after which a robot may stop although it expects no command between two trials.
_STOPS_A_CONTROLLER = ("controller-killed", "frozen-0.3", "frozen-5", "cable-out", "delay-0.3")


def safe_reaction(fault: Fault, phase: str, backend: str) -> Reaction:
    """What is safe in a phase: between trials no command is due, so that silence need not stop anything."""
    if phase == "between trials" and (fault.name in _STOPS_A_CONTROLLER or fault.name == "full-disk"):
        return "either"
    if fault.name == "loss-30" and backend not in ("zenoh", "mavlink"):
        return "either"  # a bus that loses every third packet is a fault of the robot
    return fault.safe
