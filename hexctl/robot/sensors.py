"""What a robot measures."""

from collections.abc import Collection
from typing import Literal, get_args

from hexctl.robot.servos.drivers import is_board

Sensor = Literal["joint_positions", "joint_velocities", "joint_loads", "foot_contacts", "imu", "position"]

#: Every sensor, in the order of robot files. `joint_positions` are measured angles, not echoed targets,
#: `joint_velocities` those that servos report, which no driver of hexctl reads, and `joint_loads` torques
#: from load or current. `foot_contacts` are switches at the feet. An `imu` measures orientation and angular
#: velocity, and `position` is a pose in the room: of a camera, tracker or lidar.
SENSORS: tuple[Sensor, ...] = get_args(Sensor)

#: Models of servos on a bus that report their load; no board does.
_WITH_LOAD = frozenset({"xl430-w250", "xl320", "ax12a", "ax18a", "sts3215", "sts3032", "scs0009"})

#: Usual models of drivers whose models report a load.
_USUAL = {"dynamixel": "xl430-w250", "feetech": "sts3215"}


def usual_sensors(driver: str | None, model: str | None, *, foot_switches: bool) -> tuple[Sensor, ...]:
    """Sensors of a robot file that states none: those of its servos; all without a driver.

    The model None is the usual one of the driver.
    """
    if driver is None:
        return SENSORS
    own: set[str] = {"foot_contacts"} if foot_switches or driver == "servo2040" else set()
    if not is_board(driver):
        own |= {"joint_positions", *(["joint_loads"] if (model or _USUAL.get(driver)) in _WITH_LOAD else [])}
    return in_order(own)


def failures_shown(sensors: Collection[str]) -> str:
    """Which failures of a leg these sensors show in mid-walk, for a person."""
    if "joint_positions" in sensors:
        more = set(sensors) - {"joint_positions", "joint_velocities"}
        return "legs and joints" if more else "joints and locked or limp legs"
    if not {"imu", "position"}.isdisjoint(sensors):
        return "legs that carry less"
    return "legs without load" if "foot_contacts" in sensors else "none without an IMU"


def in_words(sensors: Collection[str]) -> str:
    """Some sensors for a person."""
    names = [sensor.replace("_", " ").replace("imu", "IMU") for sensor in in_order(sensors)]
    return ", ".join(names) or "nothing"


def in_order(sensors: Collection[str]) -> tuple[Sensor, ...]:
    """Some sensors, each once, in the order of robot files."""
    return tuple(sensor for sensor in SENSORS if sensor in sensors)
