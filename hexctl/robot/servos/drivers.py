"""Drivers of servos: their names, and the ids and speeds that servos on a bus can have."""

from hexctl.options import Range
from hexctl.robot.plugins import plugin_names

#: Families of bus servos that hexctl has, `module:name`; plug-ins add to them (`hexctl.families`).
FAMILIES = {
    "dynamixel": "hexctl.backends.bus.families.dynamixel:DYNAMIXEL",
    "feetech": "hexctl.backends.bus.families.feetech:FEETECH",
    "lx16a": "hexctl.backends.bus.families.lx16a:LX16A",
}

#: Boards that make the pulses of hobby servos, `module:name`; plug-ins add to them (`hexctl.boards`).
BOARDS = {
    "servo2040": "hexctl.backends.pwm.servo2040:SERVO2040",
    "pca9685": "hexctl.backends.pwm.pca9685:PCA9685",
    "maestro": "hexctl.backends.pwm.maestro:MAESTRO",
    "ssc32": "hexctl.backends.pwm.ssc32:SSC32",
}

#: Bits per second of a line to servos.
BAUD = Range(low=1200, high=4_500_000, whole=True, unit="baud")

#: Ids that a servo can have.
SERVO_ID = Range(low=0, high=252, whole=True)


def bus_drivers() -> tuple[str, ...]:
    """Names of all families of bus servos, also those of plug-ins."""
    return tuple(dict.fromkeys((*FAMILIES, *plugin_names("families"))))


def board_drivers() -> tuple[str, ...]:
    """Names of all boards of hobby servos, also those of plug-ins."""
    return tuple(dict.fromkeys((*BOARDS, *plugin_names("boards"))))


def all_drivers() -> tuple[str, ...]:
    """Names of all drivers of a robot file."""
    return (*bus_drivers(), *board_drivers())


def is_board(name: str | None) -> bool:
    """Whether there is a board of a name; plug-ins are looked for only if hexctl has no driver of it."""
    return name in BOARDS or (name is not None and name not in FAMILIES and name in board_drivers())


def is_driver(name: str) -> bool:
    """Whether there is a driver of a name; plug-ins are looked for only if hexctl has none."""
    return name in FAMILIES or name in BOARDS or name in all_drivers()
