"""Faults of a simulated bus: what goes wrong with its line and its servos, and when.

mute:5:coxa@10  hot:2:femur:72@5  overload:4:femur@6  lost-id:3:tibia@8  bad-cable:3:femur:0.2
brown-out@12  unplug@15  replug@18  garble:0.01  wild:0.01  wild-once@5  echo
"""

import random
import re
from dataclasses import dataclass

import numpy as np

from hexctl.backends.bus.packets import PacketFormat, PacketStream
from hexctl.errors import InputError, argument
from hexctl.robot.servos.bus_map import BusMap
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_JOINTS, N_LEGS, BoolArray

ALLOWED = (
    "mute:LEG:JOINT, hot:LEG:JOINT:DEGREES_C, overload:LEG:JOINT, lost-id:LEG:JOINT, "
    "bad-cable:LEG:JOINT:SHARE, brown-out, unplug, replug, garble:SHARE, wild:SHARE, wild-once or echo, "
    "each with @SECONDS or from the start"
)

#: Kinds with a joint, and with a number.
_OF_JOINTS = ("mute", "hot", "overload", "lost-id", "bad-cable")
_WITH_SHARE = ("garble", "wild", "bad-cable")
_WITH_NUMBER = ("hot", *_WITH_SHARE)
_KINDS = (*_OF_JOINTS, "brown-out", "unplug", "replug", "garble", "wild", "wild-once", "echo")

#: Hottest that a servo can say it is, in degrees Celsius.
MOST_C = 200

#: Id of a servo that has lost its own.
FACTORY_ID = 1

#: Share of their usual voltage that is left to servos in a brown-out, at the most.
BROWN_OUT_SHARE = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class BusFault:
    """One fault.

    Attributes:
        kind: as in the words above.
        at_s: when it begins, on the clock of the simulated robot.
        joint: index of the joint, 0..17, or None for those of the line.
        value: temperature in degrees Celsius, or the share of answers that are garbled or wild.
    """

    kind: str
    at_s: float = 0.0
    joint: int | None = None
    value: float = 0.0


def parse_bus_fault(text: str) -> BusFault:
    """Fault of a text such as `mute:5:coxa@10`; raises InputError for anything else."""
    error = InputError(f"{argument('fault')}: got {text!r}; allowed: {ALLOWED}")
    words, _, at = text.partition("@")
    kind, *rest = words.split(":")
    if kind not in _KINDS or (at and not _number(at)):
        raise error
    joint = None
    if kind in _OF_JOINTS:
        legs = [str(leg) for leg in range(1, N_LEGS + 1)]
        if len(rest) < 2 or rest[0] not in legs or rest[1] not in JOINT_KINDS:
            raise error
        joint = JOINTS_PER_LEG * (int(rest[0]) - 1) + JOINT_KINDS.index(rest[1])
        rest = rest[2:]
    if len(rest) != (kind in _WITH_NUMBER) or not all(map(_number, rest)):
        raise error
    value = float(rest[0]) if rest else 0.0
    if (kind in _WITH_SHARE and value > 1) or (kind == "hot" and value > MOST_C):
        raise error
    return BusFault(kind=kind, at_s=float(at or 0), joint=joint, value=value)


class BusFaults:
    """Faults that have begun.

    Args:
        faults: all that will.
        bus_map: ids of the servos.

    Attributes:
        mute: which servos do not answer and do not obey, (18,).
        temperatures: of servos that are hot, by joint, in degrees Celsius.
        cables: shares of damaged answers of servos at the end of a bad cable, by joint.
        sudden: faults that have just begun and happen once to the servos: overload, lost-id, brown-out.
        echoes: whether the adapter sends back what it gets.
        unplugged: whether nothing gets through.
    """

    #: A servo that is hotter complains.
    HOT_C = 70.0

    #: Highest voltage in a brown-out, in which servos hold nothing.
    BROWN_OUT_V = 7.0

    def __init__(self, faults: tuple[BusFault, ...], bus_map: BusMap) -> None:
        self._to_come = sorted(faults, key=lambda fault: fault.at_s)
        self._map = bus_map
        self.mute: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.temperatures: dict[int, float] = {}
        self.cables: dict[int, float] = {}
        self.sudden: list[BusFault] = []
        self.echoes = self.unplugged = self._browned_out = False
        self._garbles = self._wild = 0.0
        self._wild_once = False
        self.advance(0.0)

    @property
    def dead(self) -> BoolArray:
        """Which servos hold nothing, (18,)."""
        return self.mute | self._browned_out

    def add(self, fault: BusFault) -> None:
        """Let another fault come, at once where its time is over."""
        self._to_come = sorted((*self._to_come, fault), key=lambda each: each.at_s)

    def advance(self, now_s: float) -> None:
        """Let faults begin that are due."""
        while self._to_come and self._to_come[0].at_s <= now_s:
            self._begin(self._to_come.pop(0))

    def voltage(self, usual_v: float) -> float:
        """Voltage at the servos."""
        return min(self.BROWN_OUT_V, BROWN_OUT_SHARE * usual_v) if self._browned_out else usual_v

    def damaged(
        self, answer: bytes, packets: PacketFormat, rng: random.Random, joint: int | None = None
    ) -> bytes:
        """An answer of a joint's servo, now and then garbled, or a whole packet with other numbers."""
        if self._wild_once or rng.random() < self._wild:
            self._wild_once = False
            for packet in PacketStream(packets).feed(answer):
                return packets.status(packet.servo_id, packet.error, rng.randbytes(len(packet.parameters)))
        return self._garbled(answer, rng, joint)

    def _garbled(self, answer: bytes, rng: random.Random, joint: int | None = None) -> bytes:
        """An answer of a joint's servo, or now and then what is left of it."""
        cable = 0.0 if joint is None else self.cables.get(joint, 0.0)
        if rng.random() >= max(self._garbles, cable):
            return answer
        how, place = rng.randrange(3), rng.randrange(len(answer))
        if how == 0:
            return answer[:place]
        if how == 1:
            return answer[:place] + bytes([rng.randrange(256)]) + answer[place + 1 :]
        return rng.randbytes(rng.randrange(1, 8)) + answer

    def _begin(self, fault: BusFault) -> None:
        if fault.kind in ("overload", "lost-id", "brown-out"):
            self.sudden.append(fault)
        if fault.joint is not None and fault.kind == "mute":
            self.mute[fault.joint] = True
        elif fault.joint is not None and fault.kind == "hot":
            self.temperatures[fault.joint] = fault.value
        elif fault.joint is not None and fault.kind == "bad-cable":
            self.cables[fault.joint] = fault.value
        elif fault.kind == "garble":
            self._garbles = fault.value
        elif fault.kind == "wild":
            self._wild = fault.value
        elif fault.kind == "wild-once":
            self._wild_once = True
        elif fault.kind == "echo":
            self.echoes = True
        elif fault.kind == "brown-out":
            self._browned_out = True
        elif fault.kind in ("unplug", "replug"):
            self.unplugged = fault.kind == "unplug"


def _number(text: str) -> bool:
    return re.fullmatch(r"[0-9]+(\.[0-9]+)?", text) is not None
