"""Options that select the robot and its address."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from hexctl.backends.sim.world import World
from hexctl.options import RARE, UNTYPED, Panel, Range, Typed
from hexctl.robot.failure_grammar import AskedFailures, AskedLegs
from hexctl.robot.model import Robot
from hexctl.robot.plugins import plugin_names
from hexctl.robot.servos.drivers import all_drivers
from hexctl.wire.links import LinkOptions

FAILURE = Panel("Failure")

#: Seeds of everything random.
SEED = Range(low=0, whole=True)


def lower_case(name: str) -> str:
    """A lower-case name; `package.module:Class` and the name of a plug-in are unchanged."""
    text = name.strip()
    if text == text.lower() or ":" in text or text in (*plugin_names("servos"), *all_drivers()):
        return text
    return text.lower()


# Without slots: a class has one base with slots, here the options of its end of the link.
@dataclass(frozen=True, kw_only=True)
class ServosOptions:
    """The robot, its servos and their port."""

    PANEL: ClassVar = "Robot"

    backend: Annotated[str, Typed(parse=lower_case, words="backends")] = "sim"
    """What moves: sim (simulation), zenoh (a robot behind hexctl serve), mavlink (a servo board), the driver
    of its servos, such as feetech or pca9685, mock (no robot), or package.module:Class (custom servos).

    Options that the backend would ignore are refused.
    """

    robot: Annotated[str | Path | Robot, Typed(words="robots")] = "ant"
    """Robot: ant, phantomx, pexod, phantomx-ax, makeyourpet, freenove-big, jethexa, lukas, or a YAML file.

    In Python also a Robot.
    """

    world: Annotated[str | Path | World | None, Typed(words="worlds")] = None
    """Simulated world: flat, slippery, slope, rough, steps, pits, ramps, a YAML file, or one of a family such
    as randomised:7; flat@0.5ms is flat at another time step. (default: flat)

    Only with sim. In Python also a World.
    """

    failed_leg: Annotated[AskedLegs, Typed(words="failed_legs"), FAILURE] = None
    """Leg that has failed, 1..6, counter-clockwise from the front: short for --failure LEG:locked. Several
    with commas, such as 2,5; with run and adapt also auto: hexctl diagnose finds it. (default: none)

    In Python a number or several.
    """

    failure: Annotated[AskedFailures, Typed(words="failures"), FAILURE] = ()
    """How a leg has failed: LEG:KIND, such as 5:limp, 5:limp:femur, 5:weak:0.3, 5:missing, 5:locked,
    5:stuck:coxa:30 (jammed at 30 degrees) or 5:unknown; several with commas. With run and drive also
    LEG:KIND@SECONDS: a simulated leg fails during the walk, such as 5:stuck:coxa@8. (default: none)

    In Python texts, Failures and FailureEvents.
    """

    all_sensors: Annotated[bool, RARE] = False
    """Simulate every sensor, also those that the robot lacks, such as joint angles of hobby servos. (default:
    those of the robot file)

    Only with sim.
    """

    seed: Annotated[int, SEED, RARE] = 0
    """Seed of everything random, a whole number, {}."""

    port: str | None = None
    """Port of the servos: /dev/ttyUSB0 or /dev/ttyUSB0:1000000; with mavlink /dev/ttyACM0:115200 or
    udpout:HOST:PORT, with pca9685 the I2C bus, /dev/i2c-1. (default: that of the robot file, with mavlink
    udpout:127.0.0.1:14550)
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotOptions(ServosOptions, LinkOptions):
    """The robot and its address."""


def check_backend_options(options: RobotOptions, *, but: tuple[str, ...] = ()) -> None:
    """Raise UnusedError for options that their backend would ignore, except `but`."""
    from hexctl.backends.registry import check_options, option_values

    # The controller learns of the failure, too.
    check_options(options.backend, **option_values(options, but=("robot", "failures", *but)))


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedOptions(RobotOptions):
    """A robot in real time or in a simulation, and its recording."""

    PANEL: ClassVar = "Recording"

    realtime: Annotated[bool, RARE, Panel("Robot")] = False
    """Simulate at the speed of a real robot, not as fast as possible."""

    record: str | Path | None = None
    """Recording to write, a new .rrd file, whose folder is made. (default: one in runs/)

    In Python None is no recording, or one in `record_folder`.
    """

    record_folder: Annotated[str | Path | None, UNTYPED] = None
    """Folder in which a new recording is named by time, robot and gait."""

    def check(self) -> None:
        """Raise UnusedError for options that the backend would ignore."""
        check_backend_options(self)
