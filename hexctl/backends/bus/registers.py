"""Registers of servo families: addresses, sizes and units."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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


@dataclass(frozen=True, kw_only=True)
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


#: Error byte of protocol 1.0: state of the servo and errors of an instruction (ROBOTIS e-Manual).
_ERRORS_1 = {0: "voltage", 2: "hot", 5: "overload"}
_REFUSALS_1 = {1: "angle limit", 3: "range", 4: "checksum", 6: "instruction"}

#: Codes in the error byte of protocol 2.0 (ROBOTIS e-Manual).
_REFUSALS_2 = {
    1: "result fail",
    2: "instruction",
    3: "CRC",
    4: "range",
    5: "length",
    6: "limit",
    7: "access",
}


def _tuned(*values: tuple[int, int, int, str]) -> tuple[FactoryValue, ...]:
    """Settings by address, size, value from the factory, and name."""
    return tuple(FactoryValue(Register(address, size), value, name) for address, size, value, name in values)


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
    ram=24,
    least=Register(6, 2),
    most=Register(8, 2),
    tuning=_tuned(
        (26, 1, 1, "CW compliance margin"),
        (27, 1, 1, "CCW compliance margin"),
        (28, 1, 32, "CW compliance slope"),
        (29, 1, 32, "CCW compliance slope"),
        (48, 2, 32, "punch"),
    ),
    status_level=(Register(16), 2),
    firmware=(Register(2),),
    voltages=(Register(12, scale=0.1), Register(13, scale=0.1)),
    shutdown=Register(18),
    protections={2: "heat", 5: "overload"},
    max_torque=Register(14, 2, scale=1 / 1023),
    torque_limit=Register(34, 2, scale=1 / 1023),
    soft_torque=Register(34, 2, scale=1 / 1023),
    speed=Register(32, 2, scale=0.666),
    errors=_ERRORS_1,
    refusals=_REFUSALS_1,
)

#: XL-320 (ROBOTIS e-Manual).
XL320 = replace(
    AX,
    protocol=2,
    position=Register(37, 2),
    effort=Register(41, 2, "bit10", 1 / 1023),
    voltage=Register(45, scale=0.1),
    temperature=Register(46),
    sync_read=True,
    mode=RequiredValue(Register(11), 2, "its operating mode"),
    p_gain=Register(29),
    tuning=_tuned((29, 1, 32, "P gain"), (28, 1, 0, "I gain"), (27, 1, 0, "D gain")),
    status_level=(Register(17), 2),
    voltages=(Register(13, scale=0.1), Register(14, scale=0.1)),
    protections={0: "overload", 1: "heat"},
    max_torque=Register(15, 2, scale=1 / 1023),
    torque_limit=Register(35, 2, scale=1 / 1023),
    soft_torque=Register(35, 2, scale=1 / 1023),
    hardware_error=Register(50),
    hardware_errors={0: "overload", 1: "hot", 2: "voltage"},
    errors={7: "hardware alert"},
    refusals=_REFUSALS_2,
)

#: Limits of acceleration and velocity of X servos, or durations in ms with a time-based profile.
_X_PROFILE = (Register(108, 4), Register(112, 4))


def _x_gains(p_gain: int, d_gain: int) -> tuple[FactoryValue, ...]:
    more = ((82, 2, 0, "I gain"), (88, 2, 0, "feedforward 2nd gain"), (90, 2, 0, "feedforward 1st gain"))
    return _tuned((84, 2, p_gain, "P gain"), (80, 2, d_gain, "D gain"), *more)


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
    ram=64,
    least=Register(52, 4),
    most=Register(48, 4),
    mode=RequiredValue(Register(11), 3, "its operating mode"),
    also_required=(
        RequiredValue(
            Register(10), 0, "its flag for moves by time (time-based profile)", 2, then_zero=_X_PROFILE
        ),
        RequiredValue(Register(10), 0, "its flag for counts in reverse", 0, writable=False),
        RequiredValue(Register(10), 0, "its flag for goals that switch its torque on", 3, writable=False),
    ),
    p_gain=Register(84, 2),
    tuning=_x_gains(640, 4000),
    offset=Register(20, 4, "twos"),
    status_level=(Register(68), 2),
    shadow_id=Register(12),
    firmware=(Register(6),),
    least_firmware=((38,), "a watchdog"),
    voltages=(Register(34, 2, scale=0.1), Register(32, 2, scale=0.1)),
    shutdown=Register(63),
    protections={2: "heat", 5: "overload"},
    max_torque=Register(36, 2, scale=1 / 885),
    soft_torque=Register(100, 2, "twos", 1 / 885),
    speed=Register(112, 4, scale=1.374),
    acceleration=Register(108, 4, scale=21.458),
    hardware_error=Register(70),
    hardware_errors={0: "voltage", 2: "hot", 3: "encoder", 4: "electrical shock", 5: "overload"},
    watchdog=Register(98),
    errors={7: "hardware alert"},
    refusals=_REFUSALS_2,
)

#: XL330 and XM430, which measure their current in place of the load.
XL330 = replace(
    X,
    effort=None,
    current=Register(126, 2, "twos", 0.001),
    least_firmware=None,
    tuning=_x_gains(400, 0),
)
XM430 = replace(X, effort=None, current=Register(126, 2, "twos", 0.00269), tuning=_x_gains(800, 0))

#: STS3215 and its kin (memory table of STS, with its phase byte, 18): at full speed, settings kept from
#: being saved. Firmware before 3.10 does not answer sync reads.
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
    ram=40,
    least=Register(9, 2),
    most=Register(11, 2),
    mode=RequiredValue(Register(33), 0, "its operating mode"),
    also_required=(
        RequiredValue(Register(18), 0, "its flag for positions beyond one turn", 4),
        RequiredValue(Register(18), 1, "its flag for a speed of 0 as full speed", 3),
        RequiredValue(Register(30), 1, "its angular resolution"),
    ),
    p_gain=Register(21),
    tuning=_tuned(
        (21, 1, 32, "P gain"),
        (22, 1, 32, "D gain"),
        (23, 1, 0, "I gain"),
        (24, 2, 16, "starting force"),
        (26, 1, 1, "CW dead zone"),
        (27, 1, 1, "CCW dead zone"),
    ),
    offset=Register(31, 2),
    slow_unit=(Register(18), 2, 50.0),
    status_level=(Register(8), 1),
    firmware=(Register(0), Register(1)),
    least_firmware=((3, 10), "readings of all servos at once"),
    voltages=(Register(15, scale=0.1), Register(14, scale=0.1)),
    variants=((9.0, "7.4 V type"), (99.0, "12 V type")),
    shutdown=Register(19),
    protections={2: "heat", 5: "overload"},
    overload_torque=Register(34, scale=0.01),
    max_torque=Register(16, 2, scale=0.001),
    torque_limit=Register(48, 2, scale=0.001),
    soft_torque=Register(48, 2, scale=0.001),
    speed=Register(46, 2, "bit15", 360 / 4096),
    acceleration=Register(41, scale=100 * 360 / 4096),
    unlock=Register(55),
    errors={0: "voltage", 1: "encoder", 2: "hot", 3: "current", 5: "overload"},
)

#: SCS0009 and its kin: big-endian, no sync read.
SCS = replace(
    STS,
    byte_order="big",
    goal=Register(42, 2),
    position=Register(56, 2),
    current=None,
    sync_read=False,
    mode=None,
    also_required=(),
    tuning=(),
    offset=None,
    slow_unit=None,
    least_firmware=None,
    variants=(),
    overload_torque=None,
    torque_limit=None,
    soft_torque=None,
    speed=Register(46, 2, scale=300 / 1023),
    acceleration=None,
    unlock=Register(48),
)

#: Registers by the beginning of a model's name.
_TABLES = {"ax": AX, "xl320": XL320, "xl330": XL330, "xl430": X, "xm430": XM430, "sts": STS, "scs": SCS}


def table_of(model: str) -> RegisterTable:
    """Registers of a model by its name, as in `SERVO_TYPES`."""
    return next(table for begin, table in _TABLES.items() if model.startswith(begin))
