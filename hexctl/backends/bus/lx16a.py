"""LewanSoul (Hiwonder) bus servos, which report no model: LX-16A, LX-224, HTS-35H.

Numbers are little-endian. Writes are not answered; an answer repeats its command, which has no parameters
(LewanSoul Bus Servo Communication Protocol).
"""

from hexctl.backends.bus.packets import SumPackets
from hexctl.backends.bus.servo import TRIES, FoundServo, Servo, ServoSettings

#: Commands that write.
MOVE, WRITE_ID, WRITE_LIMITS, WRITE_MODE, WRITE_LOAD = 1, 13, 20, 29, 31

#: Parameters of each command that writes.
WRITE_BYTES = {MOVE: 4, WRITE_ID: 1, WRITE_LIMITS: 4, WRITE_MODE: 4, WRITE_LOAD: 1}

#: Commands that ask.
READ_ID, READ_LIMITS, READ_VOLTAGE_LIMITS, READ_MOST_TEMPERATURE = 14, 21, 23, 25
READ_TEMPERATURE, READ_VOLTAGE, READ_POSITION, READ_MODE, READ_LOAD = 26, 27, 28, 30, 32

#: Parameters in the answer to each command that asks.
ANSWER_BYTES = {
    READ_ID: 1,
    READ_LIMITS: 4,
    READ_VOLTAGE_LIMITS: 4,
    READ_MOST_TEMPERATURE: 1,
    READ_TEMPERATURE: 1,
    READ_VOLTAGE: 2,
    READ_POSITION: 2,
    READ_MODE: 4,
    READ_LOAD: 1,
}

#: Longest time of a move, in ms.
MOST_MOVE_MS = 30_000

#: The one format of the family: an answer has the command that it answers in place of an error.
LX16A = SumPackets(b"\x55\x55", counted=3, most_parameters=4, most_id=0xFF, answers=ANSWER_BYTES)
LX16A.probe = READ_POSITION

#: Time of a move of a single servo, in ms: two steps of a soft motion.
MOVE_MS = 40

#: Temperature in degrees Celsius at which servos let go, from the factory.
FACTORY_MOST_C = 85


def move(servo_id: int, count: int, time_ms: int) -> bytes:
    """Packet that moves a servo to a count, 0 to 1000, in a time in ms."""
    time_ms = min(max(time_ms, 0), MOST_MOVE_MS)
    return LX16A.instruction(servo_id, MOVE, count.to_bytes(2, "little") + time_ms.to_bytes(2, "little"))


def load(servo_id: int, *, on: bool) -> bytes:
    """Packet that switches the torque of a servo."""
    return LX16A.instruction(servo_id, WRITE_LOAD, bytes([on]))


def mode(servo_id: int, *, motor: bool) -> bytes:
    """Packet that selects position mode, or motor mode at speed 0."""
    return LX16A.instruction(servo_id, WRITE_MODE, bytes([motor, 0, 0, 0]))


def number(parameters: bytes) -> int:
    """Number in the parameters of an answer; two bytes are signed."""
    return int.from_bytes(parameters, "little", signed=len(parameters) == 2)


class Lx16aServo(Servo):
    """One servo without a torque limit; each move has a duration."""

    def look(self) -> FoundServo:
        """Identity and readings of the servo."""
        position, millivolts = self.position(), self.number(READ_VOLTAGE)
        limits_mv = self._pair(READ_VOLTAGE_LIMITS)
        return FoundServo(
            servo_id=self.servo_id,
            baud=self._packets.line.baud,
            model=None,
            model_number=None,
            protocol=1,
            position=None if position is None else int(position),
            voltage_v=None if millivolts is None else round(millivolts / 1000, 1),
            temperature_c=self.number(READ_TEMPERATURE),
            variant="" if limits_mv is None else f"{limits_mv[0] / 1000:g} to {limits_mv[1] / 1000:g} V",
        )

    def number(self, command: int) -> float | None:
        """Number that answers a reading command; None without an answer."""
        answer = self._ask(command)
        return None if answer is None else float(number(answer))

    def position(self) -> float | None:
        """Position in counts."""
        return self.number(READ_POSITION)

    def torque(self, *, tries: int = TRIES) -> bool | None:
        """Whether its torque is on; None without an answer."""
        answer = self._ask(READ_LOAD, tries=tries)
        return None if answer is None else bool(answer[0])

    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque until the servo confirms it."""
        for _ in range(TRIES):
            self._packets.line.write(load(self.servo_id, on=on))
            if self.torque() is on:
                return True
        return False

    def go(self, count: float) -> str:
        """Set the goal; these servos do not acknowledge it."""
        self._packets.line.write(move(self.servo_id, round(count), MOVE_MS))
        return ""

    def settings(self) -> ServoSettings:
        """Stored limits, or those of its model without any, and differences to the factory settings."""
        least, most = self._pair(READ_LIMITS) or (0, 0)
        if not self.type.least <= least < most <= self.type.most:
            least, most = self.type.least, self.type.most
        refusal = "it is in motor mode and follows no positions; switch its power off and on"
        return ServoSettings(
            refusal=refusal if self._is_motor() else "", notes=tuple(self._notes()), least=least, most=most
        )

    def set_up(self) -> list[str]:
        """Set up a servo without torque: position mode."""
        if not self._is_motor():
            return []
        self._packets.line.write(mode(self.servo_id, motor=False))
        return ["could not end its motor mode" if self._is_motor() else "ended its motor mode"]

    def _is_motor(self) -> bool:
        stored = self._twice(lambda: self._ask(READ_MODE))
        return stored is not None and stored[0] == 1

    def _notes(self) -> list[str]:
        notes = []
        most_c = self._twice(lambda: self.number(READ_MOST_TEMPERATURE)) or FACTORY_MOST_C
        if most_c > FACTORY_MOST_C:
            notes.append(f"it lets go at {most_c:.0f} degrees C, from the factory at {FACTORY_MOST_C}")
        limits_mv, now_mv = self._pair(READ_VOLTAGE_LIMITS), self.number(READ_VOLTAGE)
        if limits_mv is not None and now_mv is not None and not limits_mv[0] <= now_mv <= limits_mv[1]:
            least_v, most_v = (each / 1000 for each in limits_mv)
            notes.append(f"it has {now_mv / 1000:.1f} V, and lets go outside {least_v:.1f} to {most_v:.1f} V")
        return notes

    def _pair(self, command: int) -> tuple[int, int] | None:
        stored = self._twice(lambda: self._ask(command))
        return None if stored is None else (number(stored[:2]), number(stored[2:]))

    def _write_id(self, servo_id: int) -> str:
        self._packets.tell(self.servo_id, WRITE_ID, bytes([servo_id]))
        return ""

    def _ask(self, command: int, *, tries: int = TRIES) -> bytes | None:
        answer = self._packets.ask(self.servo_id, command, tries=tries)
        return None if answer is None else answer.parameters
