"""What a robot measures."""

from collections.abc import Collection
from typing import Literal, get_args

from hexctl.robot.servos.drivers import bus_drivers

Sensor = Literal["joint_positions", "joint_loads", "foot_contacts", "imu", "position"]

#: Every sensor, in the order of robot files. `joint_positions` are measured angles, not echoed targets,
#: `joint_loads` torques from load or current, `foot_contacts` switches at the feet; an `imu` measures
#: orientation and angular velocity, and `position` is a pose in the room: of a camera, tracker or lidar.
SENSORS: tuple[Sensor, ...] = get_args(Sensor)

#: Those that the driver of the servos brings; servos on a bus report at least their angles.
_OF_DRIVER: dict[str | None, tuple[Sensor, ...]] = {
    None: SENSORS,
    "dynamixel": ("joint_positions", "joint_loads"),
    "feetech": ("joint_positions", "joint_loads"),
    "lx16a": ("joint_positions",),
    "servo2040": (),
    "pca9685": (),
}


def usual_sensors(driver: str | None, *, foot_switches: bool) -> tuple[Sensor, ...]:
    """Sensors of a robot file that states none: those of its servos; all without a driver."""
    own = _OF_DRIVER[driver] if driver in _OF_DRIVER else _of_plugin(driver)
    return in_order({*own, "foot_contacts"}) if foot_switches else own


def _of_plugin(driver: str | None) -> tuple[Sensor, ...]:
    return ("joint_positions",) if driver in bus_drivers() else ()


def failures_shown(sensors: Collection[str]) -> str:
    """Which failures of a leg these sensors show in mid-walk, for a person."""
    if "joint_positions" in sensors:
        return "legs and joints" if "joint_loads" in sensors else "joints and locked or limp legs"
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
