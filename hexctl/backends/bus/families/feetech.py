"""Feetech servos, which speak protocol 1.0: STS and SCS, by their memory tables."""

from dataclasses import replace

from hexctl.backends.bus.families.register_bus import RegisterBus
from hexctl.backends.bus.families.register_servo import RegisterServo
from hexctl.backends.bus.families.registers import Register, RegisterTable, RequiredValue, factory_values
from hexctl.backends.bus.family import Family
from hexctl.backends.bus.packets import PROTOCOLS
from hexctl.backends.bus.servo_type import ARC, ServoType

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
    tuning=factory_values(
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

FEETECH = Family(
    name="feetech",
    models=(
        ServoType("sts3215", 777, 4.0, STS, p_gains=(4, 254), twins="its 7.4 V and 12 V types"),
        ServoType("sts3032", None, 4.0, STS, p_gains=(4, 254)),
        ServoType("scs0009", 1284, 4.8, SCS, p_gains=(1, 254), **ARC),
    ),
    bauds=(1_000_000, 500_000, 115_200, 38_400),
    formats={1: PROTOCOLS[1]},
    servo=RegisterServo,
    bus=RegisterBus,
    ids_differ=True,
    simulated="hexctl.simulators.register_servos:RegisterServos",
)
