"""Registers of servo families: addresses, sizes and units."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

#: How a number has its sign: not at all, in two's complement, or in its bit 10 or 15.
Sign = Literal["none", "twos", "bit10", "bit15"]

_SIGN_BITS = {"bit10": 1 << 10, "bit15": 1 << 15}


@dataclass(frozen=True, slots=True)
class Register:
    """One number in a servo's memory: `size` in bytes, 1, 2 or 4.

    `scale` is the unit per count: counts of position, shares of the maximum effort, A, V or degrees Celsius.
    """

    address: int
    size: int = 1
    sign: Sign = "none"
    scale: float = 1.0

    def value(self, raw: int) -> float:
        """Number in its unit, of raw, unsigned bits."""
        flag = _SIGN_BITS.get(self.sign, 0)
        if flag:
            raw = -(raw & (flag - 1)) if raw & flag else raw & (flag - 1)
        elif self.sign == "twos" and raw >> (8 * self.size - 1):
            raw -= 1 << 8 * self.size
        return raw * self.scale

    def raw(self, value: float) -> int:
        """Raw, unsigned bits of a number in its unit."""
        number = round(value / self.scale)
        if number < 0 and self.sign == "twos":
            return number + (1 << 8 * self.size)
        if number < 0 and self.sign in _SIGN_BITS:
            return -number | _SIGN_BITS[self.sign]
        return number


@dataclass(frozen=True, slots=True)
class RequiredValue:
    """Value that a register, or one bit of it, must have for goals to be followed.

    Attributes:
        name: in messages.
        writable: whether hexctl writes it while the servo has no torque; else it refuses another value.
        then_zero: registers to set to 0 after it was written.
    """

    register: Register
    value: int
    name: str
    bit: int | None = None
    writable: bool = True
    then_zero: tuple[Register, ...] = ()

    def of(self, raw: int) -> int:
        """Its value in the raw number of its register."""
        return raw if self.bit is None else raw >> self.bit & 1

    def into(self, raw: int) -> int:
        """Raw number with the required value."""
        return self.value if self.bit is None else raw & ~(1 << self.bit) | self.value << self.bit


@dataclass(frozen=True, slots=True)
class FactoryValue:
    """Setting on which the stiffness and damping of a servo depend, and its value from the factory."""

    register: Register
    value: int
    name: str


@dataclass(frozen=True, kw_only=True, eq=False)
class RegisterTable:
    """Registers of compatible servos; None for those that a servo does not have.

    Units are counts, shares of the maximum effort or torque, A, V and degrees Celsius.
    """

    protocol: int
    byte_order: Literal["little", "big"] = "little"
    torque: Register  # 1 while the servo holds its goal
    goal: Register
    position: Register
    effort: Register | None = None
    current: Register | None = None
    voltage: Register
    temperature: Register
    model: Register
    servo_id: Register
    return_delay: Register
    sync_read: bool = True  # many servos answer one packet
    ram: int  # first volatile address; settings below it can change only without torque
    least: Register  # lowest goal that the servo takes
    most: Register  # highest goal
    mode: RequiredValue | None = None  # without one, a servo with both limits at 0 is in wheel mode
    also_required: tuple[RequiredValue, ...] = ()  # that change what counts and goals mean
    p_gain: Register | None = None  # of the position control, to which the stiffness is proportional
    tuning: tuple[FactoryValue, ...] = ()
    offset: Register | None = None  # of its counts
    slow_unit: tuple[Register, int, float] | None = None  # speeds count so many times as much without a bit
    status_level: tuple[Register, int] | None = None  # which instructions are answered, and all of them
    shadow_id: Register | None = None  # another id whose goals it follows; none above the highest id
    firmware: tuple[Register, ...] = ()  # version, its main number first
    least_firmware: tuple[tuple[int, ...], str] | None = None  # and what older versions lack
    voltages: tuple[Register, Register] | None = None  # lowest and highest supply
    variants: tuple[tuple[float, str], ...] = ()  # names of types by their highest supply in V
    shutdown: Register | None = None  # conditions under which the servo lets go
    protections: Mapping[int, str] = field(default_factory=dict)  # bits of `shutdown` that protect it
    overload_torque: Register | None = None  # share of its torque that a servo keeps after an overload
    max_torque: Register | None = None  # at power-up
    acceleration: Register | None = None  # its limit in degrees/s^2; 0 is none
    torque_limit: Register | None = None  # now; some servos set it to 0 after an overload
    soft_torque: Register | None = None  # limits the torque of single servos while they are tried
    speed: Register | None = None  # highest, 0 for full
    hardware_error: Register | None = None  # why the servo has let go
    hardware_errors: Mapping[int, str] = field(default_factory=dict)  # words for its bits
    watchdog: Register | None = None  # time in 20 ms without packets after which the servo stops
    unlock: Register | None = None  # 0 while settings are kept
    errors: Mapping[int, str] = field(default_factory=dict)  # of the error byte: how the servo is, by bit
    refusals: Mapping[int, str] = field(default_factory=dict)  # of an instruction: bits, in protocol 2 codes

    @cached_property
    def required(self) -> tuple[RequiredValue, ...]:
        """Values that a servo must have for goals to be followed."""
        return self.also_required if self.mode is None else (self.mode, *self.also_required)

    @cached_property
    def reported(self) -> tuple[Register | None, ...]:
        """Registers of position, effort, current, voltage and temperature; None for missing ones."""
        return (self.position, self.effort, self.current, self.voltage, self.temperature)

    @cached_property
    def reports(self) -> tuple[Register, ...]:
        """Registers in every report of a servo."""
        return tuple(each for each in self.reported if each is not None)

    @cached_property
    def block(self) -> tuple[int, int]:
        """First address of a report, and its size in bytes."""
        first = min(each.address for each in self.reports)
        return first, max(each.address + each.size for each in self.reports) - first

    @cached_property
    def _parts(self) -> tuple[tuple[Register, slice] | None, ...]:
        starts = [None if each is None else each.address - self.block[0] for each in self.reported]
        return tuple(
            None if each is None or start is None else (each, slice(start, start + each.size))
            for each, start in zip(self.reported, starts, strict=True)
        )

    def numbers(self, report: bytes) -> list[float]:
        """Position, effort, current, voltage and temperature in a report; NaN for missing ones."""
        order, nan = self.byte_order, float("nan")
        return [
            nan if part is None else part[0].value(int.from_bytes(report[part[1]], order))
            for part in self._parts
        ]

    def packed(self, register: Register, value: float) -> bytes:
        """Bytes of a number in its unit."""
        return register.raw(value).to_bytes(register.size, self.byte_order)

    def complaint(self, error: int) -> str:
        """Complaint in an error byte; empty for none."""
        return bit_words(self.errors, error) if error else ""

    def refusal(self, error: int) -> str:
        """Reason in an error byte why an instruction was refused; empty for none."""
        if self.protocol == 1:
            return bit_words(self.refusals, error)
        code = error & 0x7F
        return self.refusals.get(code, f"error {code}") if code else ""


def bit_words(words: Mapping[int, str], bits: int) -> str:
    """Words of the set bits, with commas; empty for none."""
    return ", ".join(each for bit, each in words.items() if bits >> bit & 1)


def factory_values(*values: tuple[int, int, int, str]) -> tuple[FactoryValue, ...]:
    """Settings by address, size, value from the factory, and name."""
    return tuple(FactoryValue(Register(address, size), value, name) for address, size, value, name in values)
