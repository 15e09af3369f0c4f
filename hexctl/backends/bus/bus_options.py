"""Options of the commands about servos on a bus."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from hexctl.backends.serial_ports import SerialAddress
from hexctl.errors import InputError, argument
from hexctl.options import RARE, Typed, check_fields
from hexctl.robot.servos.drivers import BAUD, bus_drivers, is_board

if TYPE_CHECKING:
    from hexctl.backends.bus.bus_map import BusMap
    from hexctl.backends.bus.family import Family
    from hexctl.robot.servos.servo_schema import ServosSection

#: Asks at every usual baud rate of a driver.
ALL_BAUDS = "all"


def parse_bauds(text: str) -> int | str:
    """Baud rate of a text, or `all`; raises ValueError for anything else."""
    if text == ALL_BAUDS:
        return text
    try:
        return int(BAUD.parse(text))
    except ValueError as error:
        raise ValueError(f"{error}, or {ALL_BAUDS}") from None


@dataclass(frozen=True, slots=True)
class BusAddress:
    """Driver, serial device and bits per second of a bus."""

    driver: str
    path: str
    baud: int

    @property
    def family(self) -> "Family":
        """Family of its servos."""
        from hexctl.backends.bus.family import find_family

        return find_family(self.driver)


@dataclass(frozen=True, slots=True, kw_only=True)
class BusOptions:
    """Address of a bus; the section `servos` of a robot file completes it."""

    PANEL: ClassVar = "Bus"

    driver: Annotated[str | None, Typed(words="drivers")] = None
    """Protocol of the servos: dynamixel, feetech, lx16a or that of a plug-in. (default: that of --robot, else
    required)
    """

    port: str | None = None
    """Serial device of the bus, such as /dev/ttyUSB0. (default: that of --robot, else required)"""

    baud: Annotated[int | None, BAUD, RARE] = None
    """Bits per second, {}. (default: that of --robot, else the usual one of the driver)"""

    robot: str | None = None
    """Robot file whose section servos has driver, port and baud. (default: none)"""

    def __post_init__(self) -> None:
        check_fields(self)

    def address(self) -> BusAddress:
        """Return the address from the options, the robot file, or the driver's defaults, in this order.

        Raises InputError without a driver or a port, and for a robot file with hobby servos.
        """
        from hexctl.backends.bus.family import find_family

        section = self._section()
        family = find_family(self._driver(section), named=self._named)
        baud = self.baud or section.baud or family.bauds[0]
        address = SerialAddress.parse(self.port or section.port, baud)
        return BusAddress(family.name, address.path, address.baud)

    def servo_map(self) -> "BusMap | None":
        """Return the ids of all joints by the robot file; None without one."""
        from hexctl.backends.bus.bus_map import bus_map_of
        from hexctl.robot.loader import load_robot_file

        if self.robot is None:
            return None
        section = self._section()
        p_gain = load_robot_file(self.robot).p_gain
        return bus_map_of(section, self._driver(section), p_gain, named=self._named, moves=True)

    def _section(self) -> "ServosSection":
        """Section of the robot file; empty without one."""
        from hexctl.robot.loader import load_robot_file
        from hexctl.robot.servos.servo_schema import ServosSection

        return ServosSection() if self.robot is None else load_robot_file(self.robot).content.servos

    @property
    def _named(self) -> str:
        return "servos.driver" if self.driver is None else argument("driver")

    def _driver(self, section: "ServosSection") -> str:
        if is_board(section.driver):
            raise InputError(
                f"{argument('robot')}: got {self.robot}, whose hobby servos ({section.driver}) do not "
                f"answer; allowed: a robot file with {', '.join(bus_drivers())}"
            )
        if None not in (self.driver, section.driver) and self.driver != section.driver:
            raise InputError(
                f"{argument('driver')}: got {self.driver}; allowed: {section.driver}, with this robot file"
            )
        if driver := self.driver or section.driver:
            return driver
        raise InputError(f"{argument('driver')}: got none; allowed: {', '.join(bus_drivers())}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanOptions(BusOptions):
    """Address of a bus with unknown servos."""

    bauds: Annotated[int | str | None, Typed(flag="baud", parse=parse_bauds)] = None
    """Bits per second, 1200..4500000, or all: every usual baud rate of the driver, one after the other.
    (default: that of --robot, else the usual one of the driver)
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "baud", None if self.bauds == ALL_BAUDS else self.bauds)
        check_fields(self)

    def bauds_at(self, address: BusAddress) -> tuple[int, ...]:
        """Return the baud rates to ask at."""
        return address.family.bauds if self.bauds == ALL_BAUDS else (address.baud,)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoAssignmentOptions(BusOptions):
    """Address of a bus whose servos are to be assigned to joints, and the output file."""

    output: str | Path | None = None
    """New file for the section servos of a robot file. The same command continues an unfinished one.
    (default: none, it is printed)

    Unfinished sections are kept in a file next to it.
    """

    model: Annotated[str | None, RARE] = None
    """Model of servos that do not report theirs: lx16a, lx224 or hts35h. (default: that of --robot, else the
    first)
    """

    def __post_init__(self) -> None:
        check_fields(self)
        if self.robot is not None and self.output is not None:
            raise InputError(
                f"{argument('output')} cannot be combined with {argument('robot')}; allowed: without a robot "
                "file, because none is written to"
            )

    def unreported_model(self, family: "Family") -> str | None:
        """Return the model, from the option, the robot file or the family, of servos that report none.

        Raises InputError for a model of servos that report theirs, and for one that the family does not have.
        """
        if not family.reports_model:
            names = [model.name for model in family.models]
            if self.model is not None and self.model not in names:
                raise InputError(f"{argument('model')}: got {self.model}; allowed: {', '.join(names)}")
            return family.model(self.model or self._section().model).name
        if self.model is None:
            return None
        raise InputError(
            f"{argument('model')}: got {self.model} with {family.name}; allowed: none, because its servos "
            "report their model"
        )
