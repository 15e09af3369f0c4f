"""Dynamixel servos: AX with protocol 1.0, XL-320 and X with 2.0 (ROBOTIS e-Manual)."""

from dataclasses import replace

from hexctl.backends.bus.families.register_bus import RegisterBus
from hexctl.backends.bus.families.register_servo import RegisterServo
from hexctl.backends.bus.families.registers import (
    FactoryValue,
    Register,
    RegisterTable,
    RequiredValue,
    factory_values,
)
from hexctl.backends.bus.family import Family
from hexctl.backends.bus.packets import PROTOCOLS
from hexctl.backends.bus.servo_type import ARC, ServoType

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
    tuning=factory_values(
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
    tuning=factory_values((29, 1, 32, "P gain"), (28, 1, 0, "I gain"), (27, 1, 0, "D gain")),
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
    return factory_values((84, 2, p_gain, "P gain"), (80, 2, d_gain, "D gain"), *more)


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

DYNAMIXEL = Family(
    name="dynamixel",
    models=(
        ServoType("xl430-w250", 1060, 6.5, X, p_gains=(64, 6400)),
        ServoType("xl330-m077", 1190, 3.7, XL330, p_gains=(40, 4000)),
        ServoType("xl330-m288", 1200, 3.7, XL330, p_gains=(40, 4000)),
        ServoType("xm430-w350", 1020, 10.0, XM430, p_gains=(80, 8000)),
        ServoType("xl320", 350, 6.0, XL320, p_gains=(4, 254), **ARC),
        ServoType("ax12a", 12, 9.0, AX, **ARC, twins="AX-12+"),
        ServoType("ax18a", 18, 9.0, AX, **ARC, twins="AX-18F"),
    ),
    bauds=(1_000_000, 57_600, 115_200, 2_000_000, 3_000_000, 4_000_000),
    formats={2: PROTOCOLS[2], 1: PROTOCOLS[1]},
    servo=RegisterServo,
    bus=RegisterBus,
    simulated="hexctl.simulators.register_servos:RegisterServos",
)
