"""A servo2040 with the Chica firmware, or its fork, on a pseudo-terminal."""

from typing import Any

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.backends.pwm.servo2040 import (
    AMPERES_PER_COUNT,
    COUNTS_PER_V,
    CURRENT,
    FORK_COUNTS,
    GET,
    MOST_VALUE,
    NO_CURRENT,
    PULSES_US,
    RELAY,
    SET,
    STATUS,
    TOUCH,
    VOLTAGE,
    checksum,
    decoded,
    encoded,
)
from hexctl.simulators.board_faults import BoardFault
from hexctl.simulators.simulated_board import SimulatedPulseBoard
from hexctl.types import N_JOINTS, N_LEGS, BoolArray, FloatArray, RobotState

#: The supply, in V, and what a servo draws that gives all its torque, in A.
SUPPLY_V, STALL_A = 7.4, 2.0

#: Pulse of servos without a command in the original firmware.
MIDDLE_US = 1500.0

#: A byte of a frame that comes later than this is none; the firmware waits 0.1 ms, but for a USB frame.
BYTE_S = 0.005

#: Counts of a touch input: of a foot on the floor, and of one in the air.
PRESSED, FREE = 1020, 3

#: What each word of a fault takes.
SERVO2040_FAULTS = {"mute": "", "unplug": "", "replug": "", "garble": "SHARE", "trip": "AMPERES"}


class Servo2040Board(SimulatedPulseBoard):
    """A servo2040 on a pseudo-terminal, which moves simulated joints; its model is the firmware.

    Attributes:
        pulses_us: last pulses by output, (18,); 0 for none.
        enabled: outputs with pulses once the relay is on, (18,).
    """

    kinds, models = SERVO2040_FAULTS, ("stock", "fork")
    counted = ("goals", "answers", "garbage", "torn")  # frames of which bytes came too late are torn

    def __init__(self, servos: LegServos, pwm_map: PwmMap, **options: Any) -> None:
        super().__init__(servos, pwm_map, **options)
        self._fork = self._model == "fork"
        self.pulses_us: FloatArray = np.zeros(N_JOINTS)
        self.enabled: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self.relay = False
        self._staged = False
        self._status = 0
        self._sensors = [FREE] * N_LEGS + [0, 0]
        self._data = bytearray()

    def _serve(self, timeout_s: float) -> None:
        if not self._receive(timeout_s):
            return
        while self._data:
            command = self._data.pop(0)
            if command not in (SET, GET):
                self.counts["garbage"] += 1
                continue
            if not (header := self._take(2)):
                continue
            start, count = header
            if command == GET:
                self._get(start, count)
            elif payload := self._take(2 * count):
                self._set(start, decoded(payload))

    def _receive(self, timeout_s: float) -> bool:
        data = self._line.receive(timeout_s)
        if not self._unplugged:
            self._data += data
        return bool(data)

    def _take(self, count: int) -> bytes:
        """Next bytes of a frame: a missing one reads as 7F originally, and the fork drops the frame."""
        while len(self._data) < count and self._receive(BYTE_S):
            pass
        came = self._data[:count]
        torn = len(came) < count or (self._fork and max(came, default=0) > 0x7F)
        taken = bytes(byte & 0x7F for byte in came)
        if not torn:
            del self._data[:count]
            return taken
        self.counts["torn"] += 1
        if self._fork:
            return b""
        self._data.clear()
        return taken + b"\x7f" * (count - len(taken))

    def _set(self, start: int, values: list[int]) -> None:
        self.counts["goals"] += start < TOUCH
        for index, value in enumerate(values, start):
            if index < TOUCH:
                self.pulses_us[index] = np.clip(value, *PULSES_US) if value else self.pulses_us[index]
                self.enabled[index] = value > 0
                self._staged = True
            elif index == RELAY:
                self._switch(value > 0)

    def _switch(self, on: bool) -> None:
        """Switch the relay: the fork only with a staged pose, and not after a trip."""
        if not on:
            self.relay, self._staged, self._status = False, False, 0
        elif not self._fork or (self._staged and not self._status):
            self.relay = True
            self.pulses_us[self.pulses_us == 0] = MIDDLE_US
            self.enabled[:] = True  # also those with pulse 0

    def _get(self, start: int, count: int) -> None:
        """Reply; the original sends nothing for the relay and the outputs behind it."""
        values = [round(pulse) for pulse in self.pulses_us] + self._sensors
        if self._fork:
            values += [0, self._status]
        if self._mute or (self._fork and (count == 0 or start + count > STATUS + 1)):
            return
        reply = bytes([GET, start, count]) + encoded(values[start : start + count])
        reply += bytes([checksum(reply)]) if self._fork else b""
        if self._random.random() < self._garbles:
            place = self._random.randrange(len(reply))
            reply = reply[:place] + bytes([self._random.randrange(256)] * self._random.randrange(3))
        self.counts["answers"] += 1
        if not self._unplugged:
            self._line.send(reply)

    def _begin(self, fault: BoardFault) -> None:
        super()._begin(fault)
        if fault.kind == "trip":
            self.relay = self._staged = False
            self._status = 1 | min(0x3FF, round(10 * (fault.value or 0.0))) << 1

    def _servo_targets(self) -> tuple[BoolArray, FloatArray]:
        powered: BoolArray = self.enabled[self._map.outputs] & self.relay
        return powered, self._map.angles_rad(self.pulses_us[self._map.outputs])

    def _measure(self, state: RobotState) -> None:
        if state.foot_contacts is not None:
            for leg, touch in enumerate(self._map.touches.tolist()):
                self._sensors[touch] = PRESSED if state.foot_contacts[leg] else FREE
        amperes = 0.0
        if state.joint_torques_nm is not None and self.relay:
            share = np.abs(state.joint_torques_nm) / self._robot.robot.joint_max_torque_nm
            amperes = STALL_A * float(np.clip(share, 0, 1).sum())
        scale = FORK_COUNTS if self._fork else COUNTS_PER_V
        self._sensors[VOLTAGE - TOUCH] = round(SUPPLY_V * scale)
        counts = amperes * FORK_COUNTS if self._fork else NO_CURRENT + amperes / AMPERES_PER_COUNT
        self._sensors[CURRENT - TOUCH] = min(MOST_VALUE, round(counts))
