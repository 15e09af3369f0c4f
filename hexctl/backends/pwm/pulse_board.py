"""A board that makes pulses for hobby servos: all that is special about it, in one value."""

from collections.abc import Callable
from dataclasses import dataclass

from hexctl.backends.pwm.pwm_map import BoardSettings, PwmMap, map_of
from hexctl.backends.pwm.servos import PwmServos
from hexctl.errors import argument
from hexctl.robot.plugins import find_named
from hexctl.robot.servos.drivers import BOARDS
from hexctl.robot.servos.raw_map import check_driver
from hexctl.robot.servos.servo_schema import ServosSection


@dataclass(frozen=True, kw_only=True, eq=False)
class PulseBoard:
    """A board of hobby servos.

    Attributes:
        name: its driver in robot files and commands.
        servos: class of its servos, made as `PwmServos`.
        settings: what the section `servos` of a robot file sets; raises InputError.
        has_keys: whether `settings` reads keys in the section's `board`.
        parse_port: port of a text, or None, and of the file's `baud`, or None; raises InputError.
        has_keeper: whether a second process can let the robot down if `hexctl serve` dies.
        has_watchdog: whether the board itself can end its pulses, which its servos then report.
        simulated: its `hexctl.simulators.simulated_board.SimulatedPulseBoard`, as `package.module:Class`.
    """

    name: str
    servos: type[PwmServos]
    settings: Callable[[ServosSection], BoardSettings]
    has_keys: bool = False
    parse_port: Callable[[str | None, int | None], str]
    has_keeper: bool
    has_watchdog: bool = False
    simulated: str


def find_board(name: str, *, named: str = argument("driver")) -> PulseBoard:
    """Board of a driver's name, which messages call `named`; raises InputError as `find_named`."""
    return find_named("boards", name, BOARDS, PulseBoard, named)


def pwm_map_of(section: ServosSection, driver: str) -> PwmMap:
    """PWM map of a section; raises InputError for what the driver's board does not have."""
    board = find_board(driver, named="servos.driver")
    check_driver(section, driver, has_keys=board.has_keys)
    return map_of(section, driver, board.settings(section))
