"""Faults of a simulated bus: of its line and its servos."""

import random

import numpy as np

from hexctl.backends.bus.packets import PacketFormat, PacketStream
from hexctl.simulators.board_faults import BoardFault
from hexctl.types import N_JOINTS, BoolArray

#: What each word takes.
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

    `temperatures` in degrees Celsius and shares of damaged answers (`cables`) are by joint; `noise` is the
    share of control periods with random bytes.
    """

    #: Temperature from which a servo reports an error.
    HOT_C = 70.0

    #: Highest voltage in a brown-out, in which servos hold nothing.
    BROWN_OUT_V = 7.0

    def __init__(self) -> None:
        self.mute: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.temperatures: dict[int, float] = {}
        self.cables: dict[int, float] = {}
        self._battery_v: float | None = None
        self.echoes = self._browned_out = self._wild_once = False
        self._garbles = self._wild = self.noise = 0.0

    @property
    def dead(self) -> BoolArray:
        """Which servos have no torque, (18,)."""
        return self.mute | self._browned_out

    def begin(self, fault: BoardFault) -> None:
        """Begin a fault of the line or of answers."""
        kind, joint, value = fault.kind, fault.joint, fault.value or 0.0
        if joint is not None and kind == "mute":
            self.mute[joint] = True
        elif joint is not None and kind == "only":
            self.mute[:] = True
            self.mute[joint] = False
        elif joint is not None and kind == "hot":
            self.temperatures[joint] = value
        elif joint is not None and kind == "bad-cable":
            self.cables[joint] = value
        elif kind == "garble":
            self._garbles = value
        elif kind == "battery":
            self._battery_v = value
        elif kind == "noise":
            self.noise = value
        elif kind == "wild":
            self._wild = value
        self._wild_once |= kind == "wild-once"
        self.echoes |= kind == "echo"
        self._browned_out |= kind == "brown-out"

    def voltage(self, usual_v: float) -> float:
        """Voltage at the servos."""
        usual_v = usual_v if self._battery_v is None else self._battery_v
        return min(self.BROWN_OUT_V, BROWN_OUT_SHARE * usual_v) if self._browned_out else usual_v

    def damaged(
        self, answer: bytes, packets: PacketFormat, rng: random.Random, joint: int | None = None
    ) -> bytes:
        """Answer of a joint's servo, sometimes garbled, or with wrong numbers."""
        if self._wild_once or rng.random() < self._wild:
            self._wild_once = False
            for packet in PacketStream(packets).feed(answer):
                return packets.status(packet.servo_id, packet.error, rng.randbytes(len(packet.parameters)))
        return self._garbled(answer, rng, joint)

    def _garbled(self, answer: bytes, rng: random.Random, joint: int | None = None) -> bytes:
        """Answer of a joint's servo, or sometimes parts of it."""
        cable = 0.0 if joint is None else self.cables.get(joint, 0.0)
        if rng.random() >= max(self._garbles, cable):
            return answer
        how, place = rng.randrange(3), rng.randrange(len(answer))
        if how == 0:
            return answer[:place]
        if how == 1:
            return answer[:place] + bytes([rng.randrange(256)]) + answer[place + 1 :]
        return rng.randbytes(rng.randrange(1, 8)) + answer
