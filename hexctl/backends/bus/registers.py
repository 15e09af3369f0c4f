"""Registers of servo families: where goals, positions and settings are, and what their numbers mean."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

#: How a number has its sign: not at all, in two's complement, or in its bit 10 or 15.
Sign = Literal["none", "twos", "bit10", "bit15"]


@dataclass(frozen=True, slots=True)
class Register:
    """One number in a servo's memory.

    Attributes:
        address: of its first byte.
        size: in bytes, 1, 2 or 4.
        sign: how it is signed.
        scale: unit per count: counts of position, shares of the greatest effort, A, V or degrees Celsius.
    """

    address: int
    size: int = 1
    sign: Sign = "none"
    scale: float = 1.0

    def value(self, raw: int) -> float:
        """Number of raw, unsigned bits, in its unit."""
        bits = 8 * self.size
        if self.sign == "twos" and raw >= 1 << (bits - 1):
            raw -= 1 << bits
        elif self.sign in ("bit10", "bit15"):
            flag = 1 << int(self.sign[3:])
            raw = -(raw & (flag - 1)) if raw & flag else raw & (flag - 1)
        return raw * self.scale

    def raw(self, value: float) -> int:
        """Raw, unsigned bits of a number in its unit."""
        number = round(value / self.scale)
        if number < 0 and self.sign == "twos":
            return number + (1 << 8 * self.size)
        if number < 0 and self.sign in ("bit10", "bit15"):
            return -number | 1 << int(self.sign[3:])
        return number


@dataclass(frozen=True, kw_only=True)
class RegisterTable:
    """Registers of servos that one program can treat alike.

    Attributes:
        protocol: version of the packets.
        byte_order: of numbers.
        torque: 1 where the servo holds its goal.
        goal: position in counts.
        position: in counts.
        effort: share of the greatest that the motor gives, or None.
        current: in A, or None.
        voltage: in V.
        temperature: in degrees Celsius.
        model: model number.
        servo_id: id that the servo answers to.
        return_delay: time before an answer, 0 is at once.
        sync_read: whether many servos answer one packet.
        settings: registers that are set at connect while the torque is off, and their values.
        watchdog: time in 20 ms without packets after which the servo stops, or None.
        unlock: register that is 0 where settings are kept, or None.
        errors: words for the bits of the error byte.
    """

    protocol: int
    byte_order: Literal["little", "big"] = "little"
    torque: Register
    goal: Register
    position: Register
    effort: Register | None = None
    current: Register | None = None
    voltage: Register
    temperature: Register
    model: Register
    servo_id: Register
    return_delay: Register
    sync_read: bool = True
    settings: Mapping[int, int] = field(default_factory=dict)
    watchdog: Register | None = None
    unlock: Register | None = None
    errors: Mapping[int, str] = field(default_factory=dict)

    @property
    def reports(self) -> tuple[Register, ...]:
        """Registers that are read in every report of a servo."""
        known = (self.position, self.effort, self.current, self.voltage, self.temperature)
        return tuple(each for each in known if each is not None)

    @property
    def block(self) -> tuple[int, int]:
        """First address of a report, and its size in bytes."""
        first = min(each.address for each in self.reports)
        return first, max(each.address + each.size for each in self.reports) - first

    def of_block(self, register: Register | None, data: bytes) -> float:
        """Number of a register in the bytes of a report; NaN for None."""
        if register is None:
            return float("nan")
        start = register.address - self.block[0]
        return register.value(int.from_bytes(data[start : start + register.size], self.byte_order))

    def packed(self, register: Register, value: float) -> bytes:
        """Bytes of a number in its unit."""
        return register.raw(value).to_bytes(register.size, self.byte_order)

    def complaint(self, error: int) -> str:
        """What an error byte says, in few words; empty for none."""
        return ", ".join(words for bit, words in self.errors.items() if error >> bit & 1)


#: Bits of the error byte of protocol 1.0 (ROBOTIS e-Manual).
_ERRORS_1 = {
    0: "voltage",
    1: "angle limit",
    2: "hot",
    3: "range",
    4: "checksum",
    5: "overload",
    6: "instruction",
}

#: AX-12A, AX-18A (ROBOTIS e-Manual): no sync read.
AX = RegisterTable(
    protocol=1,
    torque=Register(24),
    goal=Register(30, 2),
    position=Register(36, 2),
    effort=Register(40, 2, "bit10", 1 / 1023),
    voltage=Register(42, scale=0.1),
    temperature=Register(43),
    model=Register(0, 2),
    servo_id=Register(3),
    return_delay=Register(5),
    sync_read=False,
    errors=_ERRORS_1,
)

#: XL-320 (ROBOTIS e-Manual).
XL320 = RegisterTable(
    protocol=2,
    torque=Register(24),
    goal=Register(30, 2),
    position=Register(37, 2),
    effort=Register(41, 2, "bit10", 1 / 1023),
    voltage=Register(45, scale=0.1),
    temperature=Register(46),
    model=Register(0, 2),
    servo_id=Register(3),
    return_delay=Register(5),
    errors={7: "hardware alert"},
)

#: XL430 (ROBOTIS e-Manual).
X = RegisterTable(
    protocol=2,
    torque=Register(64),
    goal=Register(116, 4, "twos"),
    position=Register(132, 4, "twos"),
    effort=Register(126, 2, "twos", 0.001),
    voltage=Register(144, 2, scale=0.1),
    temperature=Register(146),
    model=Register(0, 2),
    servo_id=Register(7),
    return_delay=Register(9),
    watchdog=Register(98),
    errors={7: "hardware alert"},
)

#: XL330 and XM430, which measure their current in place of the load.
XL330 = replace(X, effort=None, current=Register(126, 2, "twos", 0.001))
XM430 = replace(X, effort=None, current=Register(126, 2, "twos", 0.00269))

#: STS3215 and its kin (memory table of STS): position mode at full speed, settings kept from being saved.
STS = RegisterTable(
    protocol=1,
    torque=Register(40),
    goal=Register(42, 2, "bit15"),
    position=Register(56, 2, "bit15"),
    effort=Register(60, 2, "bit10", 0.001),
    current=Register(69, 2, "bit15", 0.0065),
    voltage=Register(62, scale=0.1),
    temperature=Register(63),
    model=Register(3, 2),
    servo_id=Register(5),
    return_delay=Register(7),
    settings={33: 0},
    unlock=Register(55),
    errors={0: "voltage", 1: "encoder", 2: "hot", 3: "current", 5: "overload"},
)

#: SCS0009 and its kin: big-endian, no sync read.
SCS = RegisterTable(
    protocol=1,
    byte_order="big",
    torque=Register(40),
    goal=Register(42, 2),
    position=Register(56, 2),
    effort=Register(60, 2, "bit10", 0.001),
    voltage=Register(62, scale=0.1),
    temperature=Register(63),
    model=Register(3, 2),
    servo_id=Register(5),
    return_delay=Register(7),
    sync_read=False,
    unlock=Register(48),
    errors={0: "voltage", 1: "encoder", 2: "hot", 3: "current", 5: "overload"},
)


#: Registers by the beginning of a model's name.
_TABLES = {"ax": AX, "xl320": XL320, "xl330": XL330, "xl430": X, "xm430": XM430, "sts": STS, "scs": SCS}


def table_of(model: str) -> RegisterTable:
    """Registers of a model by its name, as in `SERVO_TYPES`."""
    return next(table for begin, table in _TABLES.items() if model.startswith(begin))
