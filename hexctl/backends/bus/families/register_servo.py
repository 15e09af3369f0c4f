"""One Dynamixel or Feetech servo on a line, by its registers."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Self

from hexctl.backends.bus.families.registers import Register, RequiredValue, bit_words
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import READ, REBOOT, WRITE, StatusPacket
from hexctl.backends.bus.servo import NO_GAIN, OFFSET, TRIES, ScannedServo, Servo, ServoSettings
from hexctl.backends.bus.servo_type import ServoType

#: Message for a silent servo.
SILENT = "no answer"

#: Advice if a setting that needs torque off fails.
_LATER = "switch its power off and on, and it is set"

#: Shares of a torque that differ by no more are the same: a count of any servo is less.
TORQUE_SHARE = 0.005

#: Torque share of a softened servo, and its speed in degrees per second.
SOFT_TORQUE, SOFT_DEG_S = 0.4, 60.0


class RegisterServo(Servo):
    """Memory of one servo; `number` is the model number that it reported, `known` if it is the model's."""

    def __init__(
        self,
        packets: PacketLine,
        servo_id: int,
        model: ServoType,
        *,
        number: int | None = None,
        known: bool = True,
    ) -> None:
        super().__init__(packets, servo_id, model)
        self.table = model.table
        self._number, self._known = number, known
        self._before: dict[Register, float] = {}
        self._stored: bytes | None = None  # memory before `ram`, while its settings are looked at

    @classmethod
    def identified(cls, packets: PacketLine, servo_id: int, models: Sequence[ServoType]) -> Self:
        """Servo with this id, of the one of some models that it reports; of the first for another number."""
        likely = cls(packets, servo_id, models[0])
        number = likely.raw(likely.table.model)
        if number is not None:
            swapped = int.from_bytes(number.to_bytes(2, "little"), "big")
            for each in (number, swapped):
                for model in models:
                    if model.number == each:
                        return cls(packets, servo_id, model, number=each)
        return cls(packets, servo_id, models[0], number=number, known=False)

    def raw(self, register: Register | None, *, tries: int = TRIES) -> int | None:
        """Raw number in a register; None without an answer or a register."""
        if register is None:
            return None
        answer = self._answer(register.address, register.size, tries=tries)
        return None if answer is None else int.from_bytes(answer.parameters, self.table.byte_order)

    def _answer(self, address: int, size: int, *, tries: int = TRIES) -> StatusPacket | None:
        """Answer with `size` bytes from an address."""
        asked = self._packets.packets.address_bytes(address, size)
        for _ in range(tries):
            answer = self._packets.ask(self.servo_id, READ, asked)
            if answer is not None and len(answer.parameters) == size:
                return answer
            if tries > 1:
                self._packets.outwait()
        return None

    def read_twice(self, register: Register | None) -> int | None:
        """Raw number of two equal reads in a row; None if they differ."""
        if register is not None and self._stored is not None and register.address < self.table.ram:
            data = self._stored[register.address : register.address + register.size]
            return int.from_bytes(data, self.table.byte_order)
        return self._twice(lambda: self.raw(register))

    @contextmanager
    def _settings_read(self) -> Iterator[None]:
        """Read all settings at once; a change ends that. Servos that refuse it are asked one by one."""

        def settings() -> bytes | None:
            answer = self._answer(0, self.table.ram, tries=1)
            return None if answer is None else answer.parameters

        self._stored = self._twice(settings)
        try:
            yield
        finally:
            self._stored = None

    def value(self, register: Register | None) -> float | None:
        """Number in a register in its unit; None without an answer or a register."""
        raw = self.raw(register)
        return None if raw is None or register is None else register.value(raw)

    def value_twice(self, register: Register | None) -> float | None:
        """Number in its unit from two equal reads in a row."""
        raw = self.read_twice(register)
        return None if raw is None or register is None else register.value(raw)

    def write(self, register: Register, value: float, *, tries: int = TRIES) -> str:
        """Write a number in its unit, again if damaged; empty if the servo took it, else the reason."""
        address = register.address.to_bytes(self._packets.packets.width, "little")
        data, said = address + self.table.packed(register, value), SILENT
        for _ in range(tries):
            answer = self._packets.ask(self.servo_id, WRITE, data)
            said = SILENT if answer is None else self.table.refusal(answer.error)
            if answer is None:
                self._packets.outwait()
            if said not in (SILENT, "CRC", "checksum"):
                break
        return said

    def change(self, register: Register, value: float) -> str:
        """Write a number if it differs, and read it back: servos drop some. Empty, or the reason."""
        if self.read_twice(register) == register.raw(value):
            return ""
        self._stored = None
        said = self.write(register, value)
        after = self.read_twice(register)
        if after == register.raw(value):
            return ""
        return said or (SILENT if after is None else f"it keeps {after}")

    def model_number(self) -> int | None:
        """Reported model number; None without an answer."""
        return self.read_twice(self.table.model)

    def look(self) -> ScannedServo:
        """Identity and readings of the servo."""
        answer = self._answer(*self.table.block)
        error = "" if answer is None else self.table.complaint(answer.error)
        if self.table.hardware_error is not None and error:
            error = f"{error} ({self.hardware_error()})"
        numbers = [math.nan] * 5 if answer is None else self.table.numbers(answer.parameters)
        position, load, current_a, voltage_v, temperature_c = (
            None if math.isnan(each) else each for each in numbers
        )
        return ScannedServo(
            servo_id=self.servo_id,
            baud=self._packets.line.baud,
            model=self.type.name if self._known else None,
            model_number=self._number,
            protocol=self.table.protocol,
            position=None if position is None else int(position),
            voltage_v=_rounded(voltage_v, 1),
            temperature_c=_rounded(temperature_c, 1),
            load=_rounded(load, 3),
            current_a=_rounded(current_a, 3),
            error=error,
            firmware=self.firmware(),
            variant=self.variant(),
            p_gain=self.read_twice(self.table.p_gain),
        )

    def firmware(self) -> str:
        """Version of its firmware; empty if unknown."""
        numbers = [self.read_twice(each) for each in self.table.firmware]
        return "" if None in numbers or not any(numbers) else ".".join(map(str, numbers))

    def variant(self) -> str:
        """Type by its supply and the limits of that; empty if unknown."""
        limits = self._voltage_limits()
        if limits is None:
            return ""
        name = next((name for most_v, name in self.table.variants if limits[1] <= most_v), "")
        words = f"{limits[0]:g} to {limits[1]:g} V"
        return f"{name}, {words}" if name else words

    def _voltage_limits(self) -> tuple[float, float] | None:
        if self.table.voltages is None:
            return None
        least_v, most_v = (self.value_twice(each) for each in self.table.voltages)
        known = least_v is not None and most_v is not None and 0 <= least_v < most_v
        return (round(least_v or 0.0, 1), round(most_v or 0.0, 1)) if known else None

    def position(self) -> float | None:
        """Position in counts."""
        return self.value(self.table.position)

    def torque(self, *, tries: int = TRIES) -> bool | None:
        """Whether its torque is on; None without an answer."""
        raw = self.raw(self.table.torque, tries=tries)
        return None if raw is None else raw == 1

    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque; ends an expired watchdog and renews a torque limit of 0."""
        if on:
            if self.table.watchdog is not None:
                self.write(self.table.watchdog, 0)
            self.renew_torque_limit()
        return not self.change(self.table.torque, float(on))

    def go(self, count: float) -> str:
        """Set the goal."""
        return self.write(self.table.goal, round(count))

    def set_up(self) -> list[str]:
        """Set up a servo without torque: immediate answers, position mode; the result is notes on changes.

        Permanent settings are written only if they differ, and not saved if the servo has a lock.
        """
        notes = self._set_up_answers()
        with self._settings_read():
            return notes + self._set_up_modes()

    def _set_up_answers(self) -> list[str]:
        """Let it answer all instructions: at level 0 it answers pings only, and has no readings."""
        if self.table.status_level is None:
            return []
        register, level = self.table.status_level
        before = self.raw(register)
        if before == level or (before is None and (not self.answers() or self.raw(register) is not None)):
            return []
        address = register.address.to_bytes(self._packets.packets.width, "little")
        self._packets.tell(self.servo_id, WRITE, address + self.table.packed(register, level))
        self._packets.outwait()
        after = self.read_twice(register)
        said = "" if after == level else SILENT if after is None else f"it keeps {after}"
        return [_changed(f"its status return level to {level}", said)]

    def _set_up_modes(self) -> list[str]:
        table, notes = self.table, list[str]()
        if self.read_twice(table.unlock) == 0:
            self._lock(open_=False)
        if said := self.change(table.return_delay, 0):
            notes.append(f"its return delay cannot be set to 0 ({said})")
        for required, now in self._deviations():
            if required.writable:
                said = self.change(required.register, required.into(now))
                notes.append(_changed(f"{required.name} from {required.of(now)} to {required.value}", said))
                if not said:
                    notes += self._set_to_zero(required.then_zero)
        return notes + self._set_p_gain()

    def _set_p_gain(self) -> list[str]:
        """Set the P gain that the robot file states, for which its stiffness holds."""
        register, wanted, now = self.table.p_gain, self.p_gain, self.read_twice(self.table.p_gain)
        if register is None or wanted is None or now in (None, wanted):
            return []
        said = self.change(register, wanted)
        return [_changed(f"its P gain from {now} to {wanted}, as the robot file states", said)]

    def _deviations(self) -> Iterator[tuple[RequiredValue, int]]:
        """Required values that the servo does not have, and the raw numbers of their registers."""
        for required in self.table.required:
            raw = self.read_twice(required.register)
            if raw is not None and required.of(raw) != required.value:
                yield required, raw

    def _set_to_zero(self, registers: Sequence[Register]) -> list[str]:
        """Set durations of moves to none: as limits of speed and acceleration they mean something else."""
        times = {each: self.read_twice(each) for each in registers}
        return [
            _changed(f"its profile register {each.address} from {time} ms to 0", self.change(each, 0))
            for each, time in times.items()
            if time
        ]

    def settings(self) -> ServoSettings:
        """Stored settings, as far as they can be read."""
        with self._settings_read():
            return self._settings()

    def _settings(self) -> ServoSettings:
        least, most = self.value_twice(self.table.least), self.value_twice(self.table.most)
        unlimited = least is None or most is None or not least < most
        return ServoSettings(
            refusal=self._refusal(least, most),
            notes=tuple(self._notes()),
            least=float("-inf") if unlimited or least is None else least,
            most=float("inf") if unlimited or most is None else most,
            firmware=self.firmware(),
            shadow_id=self.read_twice(self.table.shadow_id),
        )

    def hardware_error(self) -> str:
        """Reason of a torque loss, in words; empty if none is reported."""
        bits = self.read_twice(self.table.hardware_error)
        return "" if bits is None else bit_words(self.table.hardware_errors, bits)

    def renew_torque_limit(self) -> None:
        """Set a torque limit of 0 to the maximum; AX servos have 0 after an overload."""
        limit, stored = self.table.torque_limit, self.table.max_torque
        if limit is None or stored is None or self.read_twice(limit) != 0:
            return
        if most := self.value_twice(stored):
            self.change(limit, most)

    def soften(self) -> str:
        """Limit its torque and speed; empty if it did, else the reason."""
        refusals = []
        for register, value in ((self.table.soft_torque, SOFT_TORQUE), (self.table.speed, SOFT_DEG_S)):
            before = self.value(register)
            if register is None or before is None:
                continue
            self._before.setdefault(register, before)
            scaled = value / self._speed_unit() if register == self.table.speed else value
            # A speed of 0 is no limit.
            limit = min(before, scaled) if before or register != self.table.speed else scaled
            refusals.append(self.change(register, limit))
        return ", ".join(filter(None, refusals))

    def restore(self) -> None:
        """Restore its torque and speed."""
        for register, value in self._before.items():
            self.change(register, value)
        self._before.clear()

    def set_id(self, servo_id: int) -> str:
        """Set another id, unlocked for it if there is a lock; empty, or the reason."""
        self._lock(open_=True)
        said = super().set_id(servo_id)
        self._lock(open_=False)
        return said

    def reboot(self) -> bool:
        """Restart a servo of protocol 2, without torque."""
        if self.table.protocol == 2:
            self._packets.ask(self.servo_id, REBOOT)
        return self.table.protocol == 2

    def _write_id(self, servo_id: int) -> str:
        return self.write(self.table.servo_id, servo_id)

    def _lock(self, *, open_: bool) -> None:
        if self.table.unlock is not None:
            self.write(self.table.unlock, 0 if open_ else 1)

    def _refusal(self, least: float | None, most: float | None) -> str:
        """Why it would not follow position goals; empty if it does."""
        if not self._known:
            return f"its model number {self._number} is not known"
        if self.table.mode is None and least == most == 0:
            return "it is in wheel mode, with both angle limits at 0; set them with the vendor's tool"
        for required, now in self._deviations():
            remedy = _LATER if required.writable and self.torque() else "change that with the vendor's tool"
            return f"{required.name} is {required.of(now)}, not {required.value}; {remedy}"
        return ""

    def _notes(self) -> list[str]:
        table, notes = self.table, []
        shutdown = self.read_twice(table.shutdown)
        if shutdown is not None and (missing := bit_words(table.protections, ~shutdown)):
            notes.append(f"it does not protect itself from {missing}")
        stored, now = self.value_twice(table.max_torque), self.value_twice(table.soft_torque)
        if stored == 0:
            notes.append("its maximum torque is set to 0")
        elif stored is not None and stored < 1 - TORQUE_SHARE:
            notes.append(f"its stored maximum torque is {100 * stored:.0f} %, from the factory 100 %")
        if stored is not None and now is not None and 0 < now < stored - TORQUE_SHARE:
            notes.append(f"its torque is limited to {100 * now:.0f} % until it restarts")
        if speed := self.value_twice(table.speed):
            notes.append(f"its speed is limited to {self._speed_unit() * speed:.0f} degrees/s")
        if acceleration := self.value_twice(table.acceleration):
            notes.append(f"its acceleration is limited to {acceleration:.0f} degrees/s^2")
        notes += self._tuning_notes()
        if alert := self.hardware_error():
            bits = self.read_twice(table.hardware_error)
            tripped = shutdown is None or bits is None or bits & shutdown
            notes.append(
                f"it switched its torque off ({alert}); switch its power off and on"
                if tripped
                else f"its alert is on ({alert}), and its torque stays on"
            )
        return notes + self._variant_notes()

    def _tuning_notes(self) -> Iterator[str]:
        """Notes on settings for which stiffness and angles of the robot file do not hold."""
        table, stated = self.table, self.p_gain
        if stated is not None and table.p_gain is None:
            yield NO_GAIN
        elif stated and self.torque() and (now := self.read_twice(table.p_gain)) not in (None, stated):
            yield f"its P gain is {now}, and the robot file states {stated}; {_LATER}"
        for each in table.tuning:
            now = self.read_twice(each.register)
            if now not in (None, each.value) and (stated is None or each.register != table.p_gain):
                yield f"its {each.name} is {now}, from the factory {each.value}"
        if self.value_twice(table.offset):
            yield OFFSET

    def _speed_unit(self) -> float:
        """How many times larger its counts of a speed are."""
        if self.table.slow_unit is None:
            return 1.0
        register, bit, times = self.table.slow_unit
        flags = self.read_twice(register)
        return 1.0 if flags is None or flags >> bit & 1 else times

    def _variant_notes(self) -> list[str]:
        """Notes on a supply that it is not made for, and on old firmware."""
        notes, firmware = [], self.firmware()
        limits, volts = self._voltage_limits(), self.value_twice(self.table.voltage)
        parts = [f"firmware {firmware}" if firmware else "", self.variant()]
        kind = ", ".join(filter(None, parts))
        if limits is not None and volts and volts < limits[0]:
            notes.append(f"its supply is low, {volts:.3g} V ({kind}); charge the battery, or check its cable")
        elif limits is not None and volts and volts > limits[1]:
            notes.append(f"it has {volts:.3g} V and is made for lower voltages ({kind})")
        if self.table.least_firmware is not None and firmware:
            least, lacks = self.table.least_firmware
            if tuple(map(int, firmware.split("."))) < least:
                newest = ".".join(map(str, least))
                notes.append(f"its firmware {firmware} is older than {newest}, and lacks {lacks}; update it")
        return notes


def _rounded(number: float | None, digits: int) -> float | None:
    return None if number is None else round(number, digits)


def _changed(what: str, said: str) -> str:
    return f"could not set {what} ({said})" if said else f"set {what}"
