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

    `values` of faults of the line are by word, 1 without a number, `of_joints` those of single servos by word
    and joint: temperatures in degrees Celsius (`hot`), and shares of damaged answers (`bad-cable`).
    """

    #: Temperature from which a servo reports an error.
    HOT_C = 70.0

    #: Highest voltage in a brown-out, in which servos hold nothing.
    BROWN_OUT_V = 7.0

    def __init__(self) -> None:
        self.mute: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.values: dict[str, float] = {}
        self.of_joints: dict[str, dict[int, float]] = {"hot": {}, "bad-cable": {}}

    @property
    def dead(self) -> BoolArray:
        """Which servos have no torque, (18,)."""
        return self.mute | ("brown-out" in self.values)

    def begin(self, fault: BoardFault) -> None:
        """Begin a fault of the line or of answers."""
        value = 1.0 if fault.value is None else fault.value
        if fault.kind == "only":
            self.mute[:] = True
        if fault.joint is None:
            self.values[fault.kind] = value
        elif fault.kind in ("only", "mute"):
            self.mute[fault.joint] = fault.kind == "mute"
        elif fault.kind in self.of_joints:
            self.of_joints[fault.kind][fault.joint] = value

    def voltage(self, usual_v: float) -> float:
        """Voltage at the servos."""
        usual_v = self.values.get("battery", usual_v)
        return min(self.BROWN_OUT_V, BROWN_OUT_SHARE * usual_v) if "brown-out" in self.values else usual_v

    def damaged(
        self, answer: bytes, packets: PacketFormat, rng: random.Random, joint: int | None = None
    ) -> bytes:
        """Answer of a joint's servo, sometimes garbled, or with wrong numbers."""
        if self.values.pop("wild-once", 0.0) or rng.random() < self.values.get("wild", 0.0):
            for packet in PacketStream(packets).feed(answer):
                return packets.status(packet.servo_id, packet.error, rng.randbytes(len(packet.parameters)))
        return self._garbled(answer, rng, joint)

    def _garbled(self, answer: bytes, rng: random.Random, joint: int | None = None) -> bytes:
        """Answer of a joint's servo, or sometimes parts of it."""
        cable = 0.0 if joint is None else self.of_joints["bad-cable"].get(joint, 0.0)
        if rng.random() >= max(self.values.get("garble", 0.0), cable):
            return answer
        how, place = rng.randrange(3), rng.randrange(len(answer))
        if how == 0:
            return answer[:place]
        if how == 1:
            return answer[:place] + bytes([rng.randrange(256)]) + answer[place + 1 :]
        return rng.randbytes(rng.randrange(1, 8)) + answer
