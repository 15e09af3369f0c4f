"""Faults of simulated boards and buses."""

import math
import random
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hexctl.backends.bus.packets import PacketFormat, PacketStream
from hexctl.errors import InputError, argument
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_JOINTS, N_LEGS, BoolArray

#: Highest numbers, by their names: of a share, and of a temperature that a servo can report.
MOST = {"SHARE": 1.0, "DEGREES_C": 200.0}

_NUMBER = r"[0-9]+(?:\.[0-9]+)?"
_FAULT = re.compile(rf"([a-z-]+)((?::[a-z0-9.]+)*)(?:@({_NUMBER}))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardFault:
    """One fault; it begins at `at_s` on the clock of the simulated robot.

    `joint`, 0..17, is None for faults of the board or the line, `value` the number after the word, or None.
    """

    kind: str
    at_s: float = 0.0
    joint: int | None = None
    value: float | None = None


def parse_fault(text: str, kinds: Mapping[str, str]) -> BoardFault:
    """Fault of a text such as `mute@10`, `garble:0.01` or `hot:2:femur:72@5`.

    `kinds` are the arguments of each word, such as `SHARE` or `LEG:JOINT:DEGREES_C`, optional ones in
    brackets, with maxima in `MOST`. Raises InputError for anything else.
    """
    error = InputError(f"{argument('fault')}: got {text!r}; allowed: {_allowed(kinds)}")
    found = _FAULT.fullmatch(text)
    takes = None if found is None else kinds.get(found[1])
    if found is None or takes is None:
        raise error
    names = takes.strip("[:]").split(":") if takes else []
    given = found[2].split(":")[1:]
    if len(given) != len(names) and (given or not takes.startswith("[")):
        raise error
    joint, value = None, None
    for name, word in zip(names, given, strict=False):
        if name == "LEG" and word in map(str, range(1, N_LEGS + 1)):
            joint = JOINTS_PER_LEG * (int(word) - 1)
        elif name == "JOINT" and word in JOINT_KINDS and joint is not None:
            joint += JOINT_KINDS.index(word)
        elif re.fullmatch(_NUMBER, word) and name not in ("LEG", "JOINT"):
            value = float(word)
            if value > MOST.get(name, math.inf):
                raise error
        else:
            raise error
    return BoardFault(kind=found[1], at_s=float(found[3] or 0), joint=joint, value=value)


def _allowed(kinds: Mapping[str, str]) -> str:
    words = [f"{kind}{takes if takes[:1] in ('', '[') else f':{takes}'}" for kind, takes in kinds.items()]
    limits = [f"; {name} up to {most:g}" for name, most in MOST.items() if name in "".join(words)]
    return f"{', '.join(words)}, each with @SECONDS or from the start{''.join(limits)}"


#: What each word of a fault on a bus takes.
BUS_FAULTS = {
    "mute": "LEG:JOINT",
    "hot": "LEG:JOINT:DEGREES_C",
    "overload": "LEG:JOINT",
    "lost-id": "LEG:JOINT",
    "same-id": "LEG:JOINT",
    "only": "LEG:JOINT",
    "bad-cable": "LEG:JOINT:SHARE",
    "brown-out": "",
    "battery": "VOLTS",
    "unplug": "",
    "replug": "",
    "garble": "SHARE",
    "wild": "SHARE",
    "wild-once": "",
    "noise": "SHARE",
    "echo": "",
}

#: Maximum share of the usual voltage during a brown-out.
BROWN_OUT_SHARE = 0.6


class BusFaults:
    """Active faults; `mute` servos neither answer nor obey, (18,).

    `temperatures` in degrees Celsius and shares of damaged answers (`cables`) are by joint.
    """

    #: Temperature from which a servo reports an error.
    HOT_C = 70.0

    #: Highest voltage in a brown-out, in which servos hold nothing.
    BROWN_OUT_V = 7.0

    def __init__(self) -> None:
        self.mute: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.temperatures: dict[int, float] = {}
        self.cables: dict[int, float] = {}
        self._values: dict[str, float] = {}  # numbers of faults of the line, by word; 1 without a number

    @property
    def dead(self) -> BoolArray:
        """Which servos have no torque, (18,)."""
        return self.mute | ("brown-out" in self._values)

    @property
    def echoes(self) -> bool:
        """Whether the adapter sends back all bytes that it gets."""
        return "echo" in self._values

    @property
    def noise(self) -> float:
        """Share of control periods with random bytes."""
        return self._values.get("noise", 0.0)

    def begin(self, fault: BoardFault) -> None:
        """Begin a fault of the line or of answers."""
        value = 1.0 if fault.value is None else fault.value
        if fault.joint is None:
            self._values[fault.kind] = value
        elif fault.kind == "mute":
            self.mute[fault.joint] = True
        elif fault.kind == "only":
            self.mute = np.arange(N_JOINTS) != fault.joint
        elif fault.kind == "hot":
            self.temperatures[fault.joint] = value
        elif fault.kind == "bad-cable":
            self.cables[fault.joint] = value

    def voltage(self, usual_v: float) -> float:
        """Voltage at the servos."""
        usual_v = self._values.get("battery", usual_v)
        return min(self.BROWN_OUT_V, BROWN_OUT_SHARE * usual_v) if "brown-out" in self._values else usual_v

    def damaged(
        self, answer: bytes, packets: PacketFormat, rng: random.Random, joint: int | None = None
    ) -> bytes:
        """Answer of a joint's servo, sometimes garbled, or with wrong numbers."""
        if self._values.pop("wild-once", 0.0) or rng.random() < self._values.get("wild", 0.0):
            for packet in PacketStream(packets).feed(answer):
                return packets.status(packet.servo_id, packet.error, rng.randbytes(len(packet.parameters)))
        return self._garbled(answer, rng, joint)

    def _garbled(self, answer: bytes, rng: random.Random, joint: int | None = None) -> bytes:
        """Answer of a joint's servo, or sometimes parts of it."""
        cable = 0.0 if joint is None else self.cables.get(joint, 0.0)
        if rng.random() >= max(self._values.get("garble", 0.0), cable):
            return answer
        how, place = rng.randrange(3), rng.randrange(len(answer))
        if how == 0:
            return answer[:place]
        if how == 1:
            return answer[:place] + bytes([rng.randrange(256)]) + answer[place + 1 :]
        return rng.randbytes(rng.randrange(1, 8)) + answer
