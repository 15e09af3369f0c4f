"""The bus map: id, model, direction, offset and limits of each joint's servo on a bus; raw are counts."""

import zlib
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hexctl.backends.bus.family import Family, find_family
from hexctl.backends.bus.servo_type import ServoType
from hexctl.errors import InputError
from hexctl.robot.servos.raw_map import (
    IntPerJoint,
    RawMap,
    calibration_of,
    check_driver,
    check_once,
    joint_value,
)
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import (
    JOINT_NAMES,
    N_JOINTS,
    BoolArray,
    FloatArray,
    joint_in_words,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class BusMap(RawMap):
    """Conversion between joint angles and counts of the servos on a bus, with ids (18,), each once.

    Below `low_battery_v` the robot sits down; the default is the highest minimum supply of its models. The
    stiffness of the robot file holds for `p_gain`; None if it states none.
    """

    unit: ClassVar[str] = "counts"
    family: Family
    ids: IntPerJoint
    models: tuple[ServoType, ...]
    low_battery_v: float
    p_gain: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_once("id", JOINT_NAMES, self.ids)
        if len({(model.counts, model.registers) for model in self.models}) > 1:
            names = ", ".join(sorted({model.name for model in self.models}))
            raise InputError(f"servos.model: got {names}; allowed: models with the same registers")

    def servo_name(self, joint: int) -> str:
        """The servo of a joint, 0..17, by its id."""
        return f"id {self.ids[joint]}"

    @property
    def protocol(self) -> int:
        """Version of the family's protocol."""
        return self.models[0].protocol

    @property
    def travel(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest count of each servo's model."""
        least, most = zip(*((float(model.least), float(model.most)) for model in self.models), strict=True)
        return np.array(least), np.array(most)

    def names(self, joints: BoolArray) -> str:
        """Names and ids of joints in a mask (18,), for messages."""
        if joints.all():
            return "all servos"
        return ", ".join(
            f"{joint_in_words(joint)} (id {self.ids[joint]})" for joint in np.flatnonzero(joints).tolist()
        )


def bus_map_of(
    section: ServosSection,
    driver: str,
    p_gain: int | None = None,
    *,
    named: str = "servos.driver",
    moves: bool = False,
) -> BusMap:
    """Bus map of a section, in which messages call the driver `named`; one that `moves` needs all ids.

    Raises InputError for a driver, ids, models, limits or a P gain that no bus can have.
    """
    family = find_family(driver, named=named)
    check_driver(section, driver)
    if moves:
        _check_ids(section, driver)
    models = tuple(family.model(joint_value(section, joint, "model", None)) for joint in range(N_JOINTS))
    calibration = calibration_of(
        section, "counts", [model.least for model in models], [model.most for model in models]
    )
    for joint, model in enumerate(models):
        if p_gain is not None and model.p_gains and not model.p_gains[0] <= p_gain <= model.p_gains[1]:
            least, most = model.p_gains
            raise InputError(f"servo.p_gain: got {p_gain}; allowed: {least} to {most} ({model.name})")
        low, high = calibration["least"][joint], calibration["most"][joint]
        if low < model.least or high > model.most:
            raise InputError(
                f"servos.{JOINT_NAMES[joint]}: got min_count {low:g} and max_count {high:g}; allowed: "
                f"min_count and max_count from {model.least} to {model.most} ({model.name})"
            )
    ids = [joint_value(section, joint, "id", joint + 1) for joint in range(N_JOINTS)]
    return BusMap(
        family=family,
        ids=np.array(ids, dtype=np.int64),
        models=models,
        low_battery_v=section.low_battery_v or max(model.least_v for model in models),
        p_gain=p_gain,
        per_deg=np.array([model.counts_per_deg for model in models]),
        centre=np.array([float(model.centre) for model in models]),
        **calibration,
    )


def _check_ids(section: ServosSection, driver: str) -> None:
    """Raise InputError for a section without an id of each joint: assumed ones would exchange legs."""
    ids = [joint_value(section, joint, "id", None) for joint in range(N_JOINTS)]
    missing = [name for name, servo_id in zip(JOINT_NAMES, ids, strict=True) if servo_id is None]
    if missing:
        others = f" and {len(missing) - 1} more joints" if len(missing) > 1 else ""
        at = section.port or "PORT"
        raise InputError(
            f"servos: got no id for {missing[0]}{others}; allowed: the id of each joint, which "
            f"hexctl servos identify --driver {driver} --port {at} --output servos.yaml finds"
        )


def ids_mark(section: ServosSection) -> str:
    """Mark of the ids of all joints, by which a robot file says that they were walked through."""
    ids = [joint_value(section, joint, "id", None) for joint in range(N_JOINTS)]
    return f"{zlib.crc32(repr(ids).encode()):08x}"
