"""Options that say which robot moves, and where it is."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from hexctl.backends.sim.world import World
from hexctl.options import UNTYPED, Range, Typed
from hexctl.robot.model import Robot
from hexctl.wire.links import LinkOptions

#: Seeds of everything random.
SEED = Range(low=0, whole=True)


def lower_case(name: str) -> str:
    """A name as hexctl writes it; one with a colon, such as `package.module:Class`, as it is."""
    return name if ":" in name else name.strip().lower()


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotOptions(LinkOptions):
    """Which robot moves, and where it is."""

    backend: Annotated[str, Typed(parse=lower_case, words="backends")] = "sim"
    """What moves: sim (simulation), zenoh (a robot that hexctl serve puts on the network), mavlink (a servo
    board), dynamixel, feetech or lx16a (servos on a serial bus), servo2040 or pca9685 (boards of hobby
    servos), mock (no robot), or package.module:Class (your own servos).

    Options that the backend would ignore are refused.
    """

    robot: Annotated[str | Path | Robot, Typed(words="robots")] = "ant"
    """Robot: ant, phantomx, pexod, phantomx-ax, makeyourpet, freenove-big, jethexa, lukas, or a path to a
    YAML file.

    In Python also a Robot.
    """

    world: Annotated[str | Path | World | None, Typed(words="worlds")] = None
    """Simulated world: flat, slippery, slope, rough, a YAML file, or one of a family such as randomised:7.
    Only with sim. (default: flat)

    In Python also a World.
    """

    seed: Annotated[int, SEED] = 0
    """Seed of everything random, a whole number, {}: the same seed gives the same result."""

    connect: str | None = None
    """Where the robot is. With --backend zenoh where hexctl serve listens, such as tcp/HOST:7447 or
    tls/HOST:7447 (default: tcp/127.0.0.1:7447); with mavlink the servo board's port, such as
    /dev/ttyACM0:115200 or udpout:HOST:PORT (default: udpout:127.0.0.1:14550); with dynamixel, feetech and
    lx16a that of the bus, such as /dev/ttyUSB0:1000000 (default: that of the robot file); with servo2040
    that of the board, such as /dev/ttyACM0, and with pca9685 the I2C bus, such as 1 or /dev/i2c-1 (default:
    that of the robot file).
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedOptions(RobotOptions):
    """Which robot moves in real time or in a simulation, and where that is recorded."""

    realtime: bool = False
    """Simulate at the speed of a real robot, not as fast as possible."""

    record: str | Path | None = None
    """Recording to write, a new .rrd file, whose folder is made. (default: one in runs/)

    In Python None is no recording, or one in `record_folder`.
    """

    record_folder: Annotated[str | Path | None, UNTYPED] = None
    """Folder in which a new recording is named by time, robot and gait."""
