"""One LX-16A servo or a compatible one, which report no model."""

from hexctl.backends.bus import lx16a_packets as lx
from hexctl.backends.bus.servo import TRIES, FoundServo, Servo, ServoSettings

#: Time of a move of a single servo, in ms: two steps of a soft motion.
MOVE_MS = 40

#: Temperature in degrees Celsius at which servos let go, from the factory.
FACTORY_MOST_C = 85


class Lx16aServo(Servo):
    """One servo without a torque limit; each move has a duration."""

    def look(self) -> FoundServo:
        """Identity and readings of the servo."""
        position, millivolts = self.position(), self.number(lx.READ_VOLTAGE)
        limits_mv = self._pair(lx.READ_VOLTAGE_LIMITS)
        return FoundServo(
            servo_id=self.servo_id,
            baud=self._packets.line.baud,
            model=None,
            model_number=None,
            protocol=1,
            position=None if position is None else int(position),
            voltage_v=None if millivolts is None else round(millivolts / 1000, 1),
            temperature_c=self.number(lx.READ_TEMPERATURE),
            variant="" if limits_mv is None else f"{limits_mv[0] / 1000:g} to {limits_mv[1] / 1000:g} V",
        )

    def number(self, command: int) -> float | None:
        """Number that answers a reading command; None without an answer."""
        answer = self._ask(command)
        return None if answer is None else float(lx.number(answer))

    def position(self) -> float | None:
        """Position in counts."""
        return self.number(lx.READ_POSITION)

    def torque(self, *, tries: int = TRIES) -> bool | None:
        """Whether its torque is on; None without an answer."""
        answer = self._ask(lx.READ_LOAD, tries=tries)
        return None if answer is None else bool(answer[0])

    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque until the servo confirms it."""
        for _ in range(TRIES):
            self._packets.line.write(lx.load(self.servo_id, on=on))
            if self.torque() is on:
                return True
        return False

    def go(self, count: float) -> str:
        """Set the goal; these servos do not acknowledge it."""
        self._packets.line.write(lx.move(self.servo_id, round(count), MOVE_MS))
        return ""

    def settings(self) -> ServoSettings:
        """Stored limits, or those of its model without any, and differences to the factory settings."""
        least, most = self._pair(lx.READ_LIMITS) or (0, 0)
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
        self._packets.line.write(lx.mode(self.servo_id, motor=False))
        return ["could not end its motor mode" if self._is_motor() else "ended its motor mode"]

    def _is_motor(self) -> bool:
        stored = self._twice(lambda: self._ask(lx.READ_MODE))
        return stored is not None and stored[0] == 1

    def _notes(self) -> list[str]:
        notes = []
        most_c = self._twice(lambda: self.number(lx.READ_MOST_TEMPERATURE)) or FACTORY_MOST_C
        if most_c > FACTORY_MOST_C:
            notes.append(f"it lets go at {most_c:.0f} degrees C, from the factory at {FACTORY_MOST_C}")
        limits_mv, now_mv = self._pair(lx.READ_VOLTAGE_LIMITS), self.number(lx.READ_VOLTAGE)
        if limits_mv is not None and now_mv is not None and not limits_mv[0] <= now_mv <= limits_mv[1]:
            least_v, most_v = (each / 1000 for each in limits_mv)
            notes.append(f"it has {now_mv / 1000:.1f} V, and lets go outside {least_v:.1f} to {most_v:.1f} V")
        return notes

    def _pair(self, command: int) -> tuple[int, int] | None:
        stored = self._twice(lambda: self._ask(command))
        return None if stored is None else (lx.number(stored[:2]), lx.number(stored[2:]))

    def _write_id(self, servo_id: int) -> str:
        self._packets.tell(self.servo_id, lx.WRITE_ID, bytes([servo_id]))
        return ""

    def _ask(self, command: int, *, tries: int = TRIES) -> bytes | None:
        answer = self._packets.ask(self.servo_id, command, tries=tries)
        return None if answer is None else answer.parameters
