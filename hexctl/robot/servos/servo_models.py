"""Models of bus servos: their counts, and their drivers."""

from dataclasses import dataclass

from hexctl.errors import InputError
from hexctl.options import Range

#: Bits per second of a line to servos.
BAUD = Range(low=1200, high=4_500_000, whole=True, unit="baud")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoType:
    """A model of a bus servo; its number is None if the servo does not report it.

    Attributes:
        protocol: version of the driver's protocol, 1 or 2.
        counts: of a full turn.
        least: lowest count of its travel, as is `most` the highest.
        centre: count at the middle of its travel.
        least_v: lowest supply by its data sheet, in V.
    """

    name: str
    driver: str
    number: int | None
    protocol: int
    counts: float
    least: int
    most: int
    centre: int
    least_v: float

    @property
    def registers(self) -> str:
        """Name of the registers: models of one name can be mixed on a robot."""
        return "ax" if self.name.startswith("ax") else self.name.partition("-")[0]

    @property
    def counts_per_deg(self) -> float:
        """Counts per degree of the horn."""
        return self.counts / 360.0


def _turn(name: str, driver: str, number: int | None, protocol: int, least_v: float) -> ServoType:
    """A servo with 4096 counts a turn, all of which it can reach."""
    return ServoType(
        name=name,
        driver=driver,
        number=number,
        protocol=protocol,
        counts=4096,
        least=0,
        most=4095,
        centre=2048,
        least_v=least_v,
    )


def _arc(name: str, driver: str, number: int | None, protocol: int, least_v: float) -> ServoType:
    """A servo with 1024 counts over 300 degrees."""
    return ServoType(
        name=name,
        driver=driver,
        number=number,
        protocol=protocol,
        counts=1023 * 360 / 300,
        least=0,
        most=1023,
        centre=512,
        least_v=least_v,
    )


def _lx(name: str, least_v: float) -> ServoType:
    """A servo with 1000 counts over 240 degrees, which reports no model."""
    return ServoType(
        name=name,
        driver="lx16a",
        number=None,
        protocol=1,
        counts=1000 * 360 / 240,
        least=0,
        most=1000,
        centre=500,
        least_v=least_v,
    )


#: Models by name. Sources: ROBOTIS e-Manual (dynamixel); memory tables of STS and SCS (feetech); LewanSoul's
#: bus servo protocol (lx16a).
SERVO_TYPES: dict[str, ServoType] = {
    each.name: each
    for each in (
        _arc("ax12a", "dynamixel", 12, 1, 9.0),
        _arc("ax18a", "dynamixel", 18, 1, 9.0),
        _arc("xl320", "dynamixel", 350, 2, 6.0),
        _turn("xl330-m077", "dynamixel", 1190, 2, 3.7),
        _turn("xl330-m288", "dynamixel", 1200, 2, 3.7),
        _turn("xl430-w250", "dynamixel", 1060, 2, 6.5),
        _turn("xm430-w350", "dynamixel", 1020, 2, 10.0),
        _turn("sts3215", "feetech", 777, 1, 4.0),
        _turn("sts3032", "feetech", None, 1, 4.0),
        _arc("scs0009", "feetech", 1284, 1, 4.8),
        _lx("lx16a", 6.0),
        _lx("lx224", 6.0),
        _lx("hts35h", 9.0),
    )
}

#: Default models and bits per second of each driver.
DEFAULT_MODELS = {"dynamixel": "xl430-w250", "feetech": "sts3215", "lx16a": "lx16a"}

DEFAULT_BAUDS = {"dynamixel": 1_000_000, "feetech": 1_000_000, "lx16a": 115_200}


def servo_type(name: str) -> ServoType:
    """Model of a name; raises InputError for an unknown one."""
    if name not in SERVO_TYPES:
        raise InputError(f"servos.model: got {name!r}; allowed: {', '.join(SERVO_TYPES)}")
    return SERVO_TYPES[name]
