"""Section `servos` of a robot file: driver, port, and the wiring of each servo."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from hexctl.robot.configs import AngleDeg, Number, Positive, Section, Whole
from hexctl.robot.servos.drivers import BAUD, SERVO_ID, all_drivers, is_driver
from hexctl.types import N_JOINTS


def _driver(name: str) -> str:
    if not is_driver(name):
        raise ValueError(f"got {name!r}; allowed: {', '.join(all_drivers())}")
    return name


def _direction(value: float) -> int:
    if value not in (1, -1):
        raise ValueError(f"got {value:g}; allowed: 1 or -1")
    return int(value)


def _own_address(value: int) -> int:
    """Refuse the address at which every PCA9685 answers after a loss of power."""
    if value == 0x70:
        raise ValueError("got 0x70, at which all boards answer; allowed: another one, 0x40 to 0x7f")
    return value


def _different(values: tuple[int, int]) -> tuple[int, int]:
    if values[0] == values[1]:
        raise ValueError(f"got {values[0]:#x} twice; allowed: a different address for each board")
    return values


def _pair(value: object) -> object:
    return (value, value) if isinstance(value, int | float) else value


#: A pulse width in microseconds, within limits far wider than those of any servo.
PulseUs = Annotated[Whole, Field(ge=100, le=5000)]
Channel = Annotated[Whole, Field(ge=1, le=N_JOINTS)]
Direction = Annotated[Number, AfterValidator(_direction)]

ServoId = Annotated[Whole, Field(ge=SERVO_ID.low, le=SERVO_ID.high)]
Count = Annotated[Whole, Field(ge=0, le=65535)]
TouchInput = Annotated[Whole, Field(ge=0, le=SERVO_ID.high)]
#: A number is an I2C bus.
Port = Annotated[str, BeforeValidator(lambda value: str(value) if type(value) is int else value)]
#: An address of a PCA9685, without the one at which all answer.
I2cAddress = Annotated[Whole, Field(ge=0x40, le=0x7F), AfterValidator(_own_address)]
OscillatorMhz = Annotated[Number, Field(ge=20, le=30, allow_inf_nan=False)]
Baud = Annotated[Whole, Field(ge=BAUD.low, le=BAUD.high)]


class KindServoSection(Section):
    """Servos of one joint kind; a missing key has its default.

    Attributes:
        sign: direction of the servo, 1 or -1.
        offset_deg: angle of the servo at joint angle zero.
        min_us: shortest pulse.
        max_us: longest pulse.
        model: the servo model, if it differs from that of `servos`.
        min_count: lowest position of a bus servo.
        max_count: highest position of a bus servo.
    """

    sign: Direction | None = None
    offset_deg: AngleDeg | None = None
    min_us: PulseUs | None = None
    max_us: PulseUs | None = None
    model: str | None = None
    min_count: Count | None = None
    max_count: Count | None = None


class JointServoSection(KindServoSection):
    """Servo of one joint; a missing key has the value of its joint kind.

    Attributes:
        channel: channel of a MAVLink board.
        id: id on a serial bus, or output of a board of hobby servos.
        touch: input of the leg's foot switch.
    """

    channel: Channel | None = None
    id: ServoId | None = None
    touch: TouchInput | None = None


class ServosSection(Section):
    """Servo map: pulse = centre_us + us_per_deg * (sign * angle + offset_deg).

    Servos on a bus have a `driver`, a `model`, counts and an `id` of each joint. Boards of hobby servos have
    a `driver`, pulses, and as `id` the output of each joint.

    Attributes:
        driver: the backend of the servos.
        port: serial port, or number of the I2C bus.
        baud: baud rate of the port.
        model: servo model of all joints.
        addresses: I2C addresses of two PCA9685 boards.
        oscillator_mhz: measured oscillators of the boards.
        board: keys that only the driver of a board has.
        walked_through: mark of the ids whose legs `hexctl servos walk-through` has seen.
        if_computer_dies: whether the robot sits down or holds its pose if `hexctl serve` dies.
        us_per_deg: pulse width per degree.
        centre_us: pulse width at angle zero.
        low_battery_v: voltage below which the robot sits down; by default that of the data sheet.
        coxa: all coxa servos; `femur` and `tibia` likewise.
        leg1_coxa: single joints, which precede those of their kind.
    """

    driver: Annotated[str, AfterValidator(_driver)] | None = None
    port: Port | None = None
    baud: Baud | None = None
    model: str | None = None
    addresses: Annotated[tuple[I2cAddress, I2cAddress], AfterValidator(_different)] = (0x40, 0x41)
    oscillator_mhz: Annotated[tuple[OscillatorMhz, OscillatorMhz], BeforeValidator(_pair)] = (25.0, 25.0)
    board: dict[str, Any] = Field(default_factory=dict)
    walked_through: str | None = None
    if_computer_dies: Literal["sit", "hold"] = "sit"
    us_per_deg: Annotated[Number, Field(gt=0, le=1000, allow_inf_nan=False)] = 1000 / 90
    centre_us: PulseUs = 1500
    low_battery_v: Positive | None = None
    coxa: KindServoSection = KindServoSection()
    femur: KindServoSection = KindServoSection()
    tibia: KindServoSection = KindServoSection()
    leg1_coxa: JointServoSection = JointServoSection()
    leg1_femur: JointServoSection = JointServoSection()
    leg1_tibia: JointServoSection = JointServoSection()
    leg2_coxa: JointServoSection = JointServoSection()
    leg2_femur: JointServoSection = JointServoSection()
    leg2_tibia: JointServoSection = JointServoSection()
    leg3_coxa: JointServoSection = JointServoSection()
    leg3_femur: JointServoSection = JointServoSection()
    leg3_tibia: JointServoSection = JointServoSection()
    leg4_coxa: JointServoSection = JointServoSection()
    leg4_femur: JointServoSection = JointServoSection()
    leg4_tibia: JointServoSection = JointServoSection()
    leg5_coxa: JointServoSection = JointServoSection()
    leg5_femur: JointServoSection = JointServoSection()
    leg5_tibia: JointServoSection = JointServoSection()
    leg6_coxa: JointServoSection = JointServoSection()
    leg6_femur: JointServoSection = JointServoSection()
    leg6_tibia: JointServoSection = JointServoSection()
