"""Every quantity of a walk, declared once for the tick log, recordings, tables, bags, datasets and ROS.

A new sensor is a field of `RobotState`, a backend that measures it, and an entry of `COLUMNS`.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

from hexctl.types import JOINT_NAMES, N_LEGS

LEG_NAMES = tuple(f"leg{leg}" for leg in range(1, N_LEGS + 1))

#: Binary places of stored numbers: an error of 8 millionths of their unit at most, such as 8 um or 8 urad/s.
FINE_BITS = 16

#: Binary places of coarser ones: an error of 2 thousandths of their unit at most, such as 2 mN m or 2 mrad/s.
COARSE_BITS = 8

#: Ticks between rows of sparse quantities: ten rows a second.
SPARSE_TICKS = 5

#: ROS message of a quantity: a field of `JointState`, a `TwistStamped`, or an array.
Message = Literal["effort", "velocity", "twist", "array"]


@dataclass(frozen=True, slots=True)
class Column:
    """A quantity with a value at each tick: the newest measurement, momentary and not clipped.

    Unknown numbers are NaN, and a log keeps truths as 0 or 1. Torques may be means of the control period.

    Attributes:
        name: in the log.
        shape: of a value, () for a number.
        kind: float, int or bool.
        parts: names of its numbers; a single number is called like the column.
        table: names of its numbers in tables, with a part for {}.
        source: attribute of `RobotState`; empty if hexctl knows it without a measurement.
        optional: whether a robot may not measure it.
        entity: in recordings; None if its numbers are not recorded.
        title: of its plot, and its name in diagnostics, with the unit.
        ticks: between recorded rows.
        bits: stored binary places.
        topic: in bags and of a ROS node; None for none.
        message: of the topic.
        feature: in LeRobot datasets; None for none.
    """

    name: str
    shape: tuple[int, ...] = ()
    kind: type = float
    _: KW_ONLY
    parts: tuple[str, ...] = ()
    table: str = "{}"
    source: str = ""
    optional: bool = False
    entity: str | None = None
    title: str = ""
    ticks: int = 1
    bits: int = COARSE_BITS
    topic: str | None = None
    message: Message = "array"
    feature: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", self.parts or (self.name,))

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of its numbers in tables, such as `measured_leg1_coxa_rad`."""
        return tuple(self.table.format(part) for part in self.parts)


def _column(name: str, parts: Sequence[str], table: str, **more: Any) -> Column:
    return Column(name, (len(parts),), parts=tuple(parts), table=table, **more)


def _sensor(name: str, parts: Sequence[str], table: str, **more: Any) -> Column:
    """Column of an attribute of `RobotState` that may be None."""
    return _column(name, parts, table, **{"source": name, "optional": True, **more})


#: The columns of a log, in the order of data frames.
COLUMNS: tuple[Column, ...] = (
    Column("time_s"),  # on the clock of the servos
    Column("phase", kind=int),  # index in `PHASES`
    _column("commanded_rad", JOINT_NAMES, "commanded_{}_rad"),  # which the guard let pass
    _column("measured_rad", JOINT_NAMES, "measured_{}_rad", source="joint_positions_rad"),
    _sensor("base_position_world", "xyz", "base_{}_m"),
    _sensor("base_quaternion_world", "wxyz", "base_q{}"),
    _sensor(
        "foot_contacts",
        LEG_NAMES,
        "contact_{}",
        kind=bool,
        entity="foot_contacts",
        title="feet on the floor",
        topic="/foot_contacts",
        feature="observation.contacts",
    ),
    _sensor(
        "joint_torques_nm",
        JOINT_NAMES,
        "torque_{}_nm",
        entity="joint_torques",
        title="torques (N m)",
        ticks=SPARSE_TICKS,
        topic="/joint_torques",
        message="effort",
    ),
    _sensor(
        "joint_velocities_rad_s",
        JOINT_NAMES,
        "velocity_{}_rad_s",
        entity="joint_velocities",
        title="joint velocities (rad/s)",
        topic="/joint_velocities",
        message="velocity",
        feature="observation.joint_velocities",
    ),
    _sensor(
        "angular_velocity_body_rad_s",
        "xyz",
        "angular_velocity_{}_rad_s",
        entity="angular_velocity",
        title="angular velocity (rad/s)",
        bits=FINE_BITS,
        feature="observation.angular_velocity",
    ),
    _column(
        "velocity_body",
        ("forward_m_s", "left_m_s", "turn_rad_s"),
        "commanded_{}",
        optional=True,
        entity="commanded_velocity",
        title="commanded velocity",
        ticks=SPARSE_TICKS,
        bits=FINE_BITS,
        topic="/recorded/velocity_command",
        message="twist",
    ),
    _column("leg_suspicion", LEG_NAMES, "suspicion_{}"),  # an alarm at 1
    _column("requested_rad", JOINT_NAMES, "requested_{}_rad"),  # which the controller returned
    Column("late_s"),  # how much later than planned the tick began
    Column("work_s"),
)

COLUMN_NAMES = tuple(column.name for column in COLUMNS)

#: Columns that a recording stores as numbers, besides the joint angles.
RECORDED = tuple(column for column in COLUMNS if column.entity is not None)

#: Columns that a robot measures: attributes of `RobotState`.
SENSED = tuple(column for column in COLUMNS if column.source)

#: The numbers of `ServoReadings`; its efforts are not recorded.
READINGS = tuple(
    _column(name, JOINT_NAMES, table, entity=entity, title=title)
    for name, entity, table, title in (
        ("temperatures_c", "servos/temperatures", "temperature_{}_c", "temperature (C)"),
        ("voltages_v", "servos/voltages", "voltage_{}_v", "voltage (V)"),
        ("currents_a", "servos/currents", "current_{}_a", "current (A)"),
        ("ages_s", "servos/ages", "age_{}_s", "age of the angle (s)"),
        ("efforts", None, "effort_{}", "effort"),
    )
)
