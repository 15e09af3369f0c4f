"""Models of bus servos: their counts, and their drivers."""

from dataclasses import dataclass
from typing import Any

from hexctl.errors import InputError
from hexctl.options import Range

#: Bits per second of a line to servos.
BAUD = Range(low=1200, high=4_500_000, whole=True, unit="baud")

#: Ids that a servo can have.
SERVO_ID = Range(low=0, high=252, whole=True)


@dataclass(frozen=True, slots=True)
class ServoType:
    """A model of a bus servo; its number is None if the servo does not report it.

    Attributes:
        protocol: version of the driver's protocol, 1 or 2.
        least_v: lowest supply by its data sheet, in V.
        counts: of a full turn.
        least: lowest count of its travel, as is `most` the highest.
        centre: count at the middle of its travel.
        p_gains: lowest and highest P gain: a tenth and ten times that of the factory, because a number for
            another model is no other stiffness, but a mistake; None without a P gain.
    """

    name: str
    driver: str
    number: int | None
    protocol: int
    least_v: float
    counts: float = 4096
    least: int = 0
    most: int = 4095
    centre: int = 2048
    p_gains: tuple[int, int] | None = None

    @property
    def registers(self) -> str:
        """Name of the registers: models of one name can be mixed on a robot."""
        return "ax" if self.name.startswith("ax") else self.name.partition("-")[0]

    @property
    def counts_per_deg(self) -> float:
        """Counts per degree of the horn."""
        return self.counts / 360.0


#: Servos with 1024 counts over 300 degrees, and with 1000 counts over 240 degrees.
_ARC: dict[str, Any] = {"counts": 1023 * 360 / 300, "most": 1023, "centre": 512}
_LX: dict[str, Any] = {"counts": 1000 * 360 / 240, "most": 1000, "centre": 500}

#: Models by name. Sources: ROBOTIS e-Manual (dynamixel); memory tables of STS and SCS (feetech); LewanSoul's
#: bus servo protocol (lx16a).
SERVO_TYPES: dict[str, ServoType] = {
    each.name: each
    for each in (
        ServoType("ax12a", "dynamixel", 12, 1, 9.0, **_ARC),
        ServoType("ax18a", "dynamixel", 18, 1, 9.0, **_ARC),
        ServoType("xl320", "dynamixel", 350, 2, 6.0, p_gains=(4, 254), **_ARC),
        ServoType("xl330-m077", "dynamixel", 1190, 2, 3.7, p_gains=(40, 4000)),
        ServoType("xl330-m288", "dynamixel", 1200, 2, 3.7, p_gains=(40, 4000)),
        ServoType("xl430-w250", "dynamixel", 1060, 2, 6.5, p_gains=(64, 6400)),
        ServoType("xm430-w350", "dynamixel", 1020, 2, 10.0, p_gains=(80, 8000)),
        ServoType("sts3215", "feetech", 777, 1, 4.0, p_gains=(4, 254)),
        ServoType("sts3032", "feetech", None, 1, 4.0, p_gains=(4, 254)),
        ServoType("scs0009", "feetech", 1284, 1, 4.8, p_gains=(1, 254), **_ARC),
        ServoType("lx16a", "lx16a", None, 1, 6.0, **_LX),
        ServoType("lx224", "lx16a", None, 1, 6.0, **_LX),
        ServoType("hts35h", "lx16a", None, 1, 9.0, **_LX),
    )
}

#: Default models and bits per second of each driver.
DEFAULT_MODELS = {"dynamixel": "xl430-w250", "feetech": "sts3215", "lx16a": "lx16a"}

DEFAULT_BAUDS = {"dynamixel": 1_000_000, "feetech": 1_000_000, "lx16a": 115_200}

#: Bits per second that servos of each driver have from the factory or are usually given.
USUAL_BAUDS = {
    "dynamixel": (1_000_000, 57_600, 115_200, 2_000_000, 3_000_000, 4_000_000),
    "feetech": (1_000_000, 500_000, 115_200, 38_400),
    "lx16a": (115_200,),
}


def servo_type(name: str) -> ServoType:
    """Model of a name; raises InputError for an unknown one."""
    if name not in SERVO_TYPES:
        raise InputError(f"servos.model: got {name!r}; allowed: {', '.join(SERVO_TYPES)}")
    return SERVO_TYPES[name]
