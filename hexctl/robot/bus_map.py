"""The bus map: id, model, direction, offset and limits of each joint's servo on a bus.

count = centre + counts_per_deg * (sign * angle_deg + offset_deg)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.robot.schema import BUS_DRIVERS, ServosSection
from hexctl.robot.servo_models import DEFAULT_MODELS, ServoType, servo_type
from hexctl.types import (
    JOINT_KINDS,
    JOINT_NAMES,
    JOINTS_PER_LEG,
    N_JOINTS,
    ArrayFields,
    BoolArray,
    FloatArray,
    check_finite,
)

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class BusMap(ArrayFields):
    """Conversion between joint angles and counts of the servos on a bus.

    Arrays are by joint, leg-major, (18,).

    Attributes:
        driver: one of `BUS_DRIVERS`.
        ids: bus id of each joint's servo, each once.
        models: model of each joint's servo, of one protocol.
        signs: direction of each servo, 1 or -1.
        offsets_deg: mounting error of each servo's horn.
        least: lowest count of each servo.
        most: highest count of each servo.
    """

    driver: str
    ids: IntArray
    models: tuple[ServoType, ...]
    signs: FloatArray
    offsets_deg: FloatArray
    least: FloatArray
    most: FloatArray

    def __post_init__(self) -> None:
        for name in ("ids", "signs", "offsets_deg", "least", "most"):
            check_finite(getattr(self, name), (N_JOINTS,), f"servos.{name}")
        _check_ids(self.ids)
        _check_models(self.driver, self.models)

    @property
    def protocol(self) -> int:
        """Version of the driver's protocol that the servos speak."""
        return self.models[0].protocol

    @property
    def counts_per_deg(self) -> FloatArray:
        """Scale of each servo, (18,)."""
        return np.array([model.counts_per_deg for model in self.models])

    @property
    def centre(self) -> FloatArray:
        """Count at the middle of each servo's travel, (18,)."""
        return np.array([model.centre for model in self.models], dtype=float)

    def counts(self, positions_rad: FloatArray) -> FloatArray:
        """Counts of angles (18,) in rad, without limits and not rounded."""
        degrees = self.signs * np.degrees(positions_rad) + self.offsets_deg
        return np.asarray(self.centre + self.counts_per_deg * degrees)

    def angles_rad(self, counts: FloatArray) -> FloatArray:
        """Angles in rad of counts (18,)."""
        degrees = (counts - self.centre) / self.counts_per_deg - self.offsets_deg
        return np.asarray(np.radians(self.signs * degrees))

    def outside(self, positions_rad: FloatArray) -> BoolArray:
        """Joints whose angles (18,) in rad need a count beyond the limits, (18,)."""
        counts = self.counts(positions_rad)
        # A thousandth of tolerance: an angle right at the limit may be rounded past it.
        return np.asarray((counts < self.least - 1e-3) | (counts > self.most + 1e-3))

    def limited_rad(self, positions_rad: FloatArray) -> FloatArray:
        """Angles (18,) in rad, clipped to the limits."""
        return self.angles_rad(np.clip(self.counts(positions_rad), self.least, self.most))

    def joint_of(self, servo_id: int) -> int | None:
        """Index of the joint with a bus id, or None."""
        places = np.flatnonzero(self.ids == servo_id)
        return int(places[0]) if len(places) else None

    def names(self, joints: BoolArray) -> str:
        """Names and ids of some joints, (18,), as messages give them."""
        return ", ".join(
            f"leg {joint // JOINTS_PER_LEG + 1} {JOINT_KINDS[joint % JOINTS_PER_LEG]} (id {self.ids[joint]})"
            for joint in np.flatnonzero(joints).tolist()
        )


def bus_map_of(section: ServosSection, driver: str) -> BusMap:
    """Bus map of a section `servos` for a driver: keys of a joint come first, then of its kind, then common.

    Raises InputError for ids, models or limits that no bus can have.
    """
    if section.driver not in (None, driver):
        raise InputError(f"servos.driver: got {section.driver}; allowed: {driver}, with the backend {driver}")
    rows = [_row(section, driver, number, name) for number, name in enumerate(JOINT_NAMES, start=1)]
    ids, models, signs, offsets, least, most = zip(*rows, strict=True)
    return BusMap(
        driver=driver,
        ids=np.array(ids, dtype=np.int64),
        models=models,
        signs=np.array(signs),
        offsets_deg=np.array(offsets),
        least=np.array(least),
        most=np.array(most),
    )


def _row(
    section: ServosSection, driver: str, number: int, name: str
) -> tuple[int, ServoType, float, float, float, float]:
    """Id, model, sign, offset, lowest and highest count of one joint."""
    joint, kind = getattr(section, name), getattr(section, JOINT_KINDS[(number - 1) % JOINTS_PER_LEG])

    def value(key: str, default: float) -> float:
        own, common = getattr(joint, key), getattr(kind, key)
        return float(own if own is not None else common if common is not None else default)

    model = servo_type(joint.model or kind.model or section.model or DEFAULT_MODELS[driver])
    least, most = value("min_count", model.least), value("max_count", model.most)
    if not model.least <= least < most <= model.most:
        raise InputError(
            f"servos.{name}: got min_count {least:g} and max_count {most:g}; allowed: min_count below "
            f"max_count, both {model.least} to {model.most} ({model.name})"
        )
    servo_id = number if joint.id is None else joint.id
    return servo_id, model, value("sign", 1.0), value("offset_deg", 0.0), least, most


def _check_ids(ids: IntArray) -> None:
    """Raise InputError unless every joint has an id of its own."""
    for servo_id in ids.tolist():
        sharing = [name for name, own in zip(JOINT_NAMES, ids, strict=True) if own == servo_id]
        if len(sharing) > 1:
            raise InputError(f"servos: got id {servo_id} for {' and '.join(sharing)}; allowed: each id once")


def _check_models(driver: str, models: tuple[ServoType, ...]) -> None:
    """Raise InputError unless one driver speaks to all models, with one protocol."""
    if driver not in BUS_DRIVERS:
        raise InputError(f"servos.driver: got {driver!r}; allowed: {', '.join(BUS_DRIVERS)}")
    for model in models:
        if model.driver != driver:
            raise InputError(f"servos.model: got {model.name} with {driver}; allowed: models of {driver}")
    kinds = {(model.protocol, model.counts, model.registers) for model in models}
    if len(kinds) > 1 and driver != "lx16a":  # which has no registers
        names = sorted({model.name for model in models})
        raise InputError(f"servos.model: got {', '.join(names)}; allowed: models with the same registers")
