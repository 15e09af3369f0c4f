"""Feasibility of a gait on a robot: ranges, reach, speeds, torques, sag, clearance, servo pulses."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.backends.registry import raw_map_of
from hexctl.control.checks.gait_load import GaitLoad, Verdict, gait_load, load_verdict
from hexctl.control.planning.stance_width import stance_width
from hexctl.control.planning.static_stability import most_stable_slots
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import AUTO, DEFAULT_GAIT, Gait, Motion, ideal_speed_m_s, make_gait
from hexctl.ik.legs import TOLERANCE_RAD, range_excess_rad, solve_legs
from hexctl.robot.formats.link_masses import inertia_doubts
from hexctl.robot.loader import load_robot_file
from hexctl.robot.model import Robot
from hexctl.robot.schema import RobotSchema
from hexctl.robot.sensors import failures_shown
from hexctl.robot.servos.raw_map import (
    RawMap,
    joints_beyond,
    joints_beyond_travel,
    joints_without_stance,
    stance_problems,
)
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.robot.unit_doubts import carried_doubt, mass_doubt, slowness_doubt, unit_doubts
from hexctl.types import JOINT_NAMES, ArrayFields, FloatArray

#: Evaluated points of one gait cycle.
POINTS = 720

#: Shares of the needed joint speed: a robot below cannot walk, and one above is hardly slowed by clipping.
LEAST_SPEED, GOOD_SPEED = 0.2, 0.4

#: Headings of a check without a heading: all round, every 15 degrees.
HEADINGS_RAD = tuple(math.radians(degrees) for degrees in range(0, 360, 15))


@dataclass(frozen=True, slots=True, eq=False)
class GaitDemand(ArrayFields):
    """The demand of a gait at full stride, the worst over motions and time; joint arrays are (18,).

    Attributes:
        limits_exceeded: indices 0..17 of joints that leave their range.
        max_pace_hz: by the joint speed limits; None in a turn, whose stroke grows as the pace shrinks.
        speed_share: speed limit over the needed speed at the gait's own pace, the least of all joints.
    """

    lowest_rad: FloatArray
    highest_rad: FloatArray
    peak_speed_rad_s: FloatArray
    unreachable_legs: tuple[int, ...]
    limits_exceeded: tuple[int, ...]
    max_pace_hz: float | None
    speed_share: float
    least_foot_spacing_m: float

    @property
    def possible(self) -> bool:
        """Whether every foot is in reach and every joint in its range."""
        return not (self.unreachable_legs or self.limits_exceeded)

    @property
    def speed_reached(self) -> bool:
        """Whether no joint exceeds its speed limit at the gait's own pace."""
        return self.speed_share >= 1


def gait_demand(robot: Robot, gait: Gait, motions: Sequence[Motion]) -> GaitDemand:
    """Demand of a gait, the worst over the motions."""
    cycle_s = np.arange(POINTS + 1) / (POINTS * gait.pace_hz)
    time_s = RAMP_DURATION_S + cycle_s
    feet = np.stack([gait_feet_body(robot, gait, motion, time_s) for motion in motions])
    solution = solve_legs(robot, feet)
    joints = solution.joint_positions_rad  # (motions, points, 18)
    speed = np.abs(np.diff(joints, axis=1)).max(axis=(0, 1)) / cycle_s[1]
    lowest, highest = joints.min(axis=(0, 1)), joints.max(axis=(0, 1))
    outside = range_excess_rad(robot, np.stack([lowest, highest])).max(axis=0) > TOLERANCE_RAD
    in_reach = solution.reachable.all(axis=(0, 1))
    spacing = np.linalg.norm(feet - np.roll(feet, -1, axis=-2), axis=-1)
    share = float((robot.joint_max_speed_rad_s / np.maximum(speed, 1e-9)).min())
    turning = any(motion.turn_rate_rad_s for motion in motions)
    return GaitDemand(
        lowest_rad=lowest,
        highest_rad=highest,
        peak_speed_rad_s=speed,
        unreachable_legs=tuple(int(leg) + 1 for leg in np.flatnonzero(~in_reach)),
        limits_exceeded=tuple(int(joint) for joint in np.flatnonzero(outside)),
        max_pace_hz=None if turning else gait.pace_hz * share,
        speed_share=share,
        least_foot_spacing_m=float(spacing.min()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotCheck:
    """Feasibility of a gait on the robot of a file; driver None is a servo board.

    `servos_given` is whether the file describes its servos.
    """

    robot: Robot
    gait: Gait
    demand: GaitDemand
    load: GaitLoad
    servo_map: RawMap
    driver: str | None = None
    to_measure: tuple[str, ...] = ()
    mesh_parts: tuple[str, ...] = ()
    servos_given: bool = False
    unit_doubts: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Verdict on load, joint speeds, distances of the feet and limits of the servos."""
        load = load_verdict(self.load)
        return Verdict(
            obstacles=(*load.obstacles, *self._obstacles()),
            doubts=(*self._doubts(), *load.doubts),
            remarks=load.remarks,
        )

    def _obstacles(self) -> Iterator[str]:
        if self.demand.speed_share < LEAST_SPEED:
            yield _slow(self.demand.speed_share)
        if (clearance_m := self.robot.trunk_clearance_m) <= 0:
            yield _trunk_is_low(f"{1000 * abs(clearance_m):.3g} mm below the floor")
        yield from stance_problems(self._without_stance)

    @property
    def _without_stance(self) -> dict[str, tuple[float, float, float]]:
        return joints_without_stance(self.servo_map, self.robot) if self.servos_given else {}

    def _doubts(self) -> Iterator[str]:
        if LEAST_SPEED <= self.demand.speed_share < GOOD_SPEED:
            yield _slow(self.demand.speed_share)
        clearance_m, sag_m = self.robot.trunk_clearance_m, self.load.typical_sag_m
        if 0 < clearance_m <= sag_m:
            yield _trunk_is_low(
                f"{1000 * clearance_m:.3g} mm above the floor and sinks by {1000 * sag_m:.3g} mm"
            )
        yield from self.unit_doubts
        least_m, spacing_m = 2 * self.robot.foot_radius_m, self.demand.least_foot_spacing_m
        if spacing_m <= least_m:
            within = f"{1000 * spacing_m:.0f} mm"
            yield f"feet touch: they come within {within} and are {1000 * least_m:.0f} mm thick"
        yield from inertia_doubts(self.robot)
        if self.servos_given and not self.gait_fits_servos:
            yield "the gait goes beyond the limits of the servos (section `servos`), which clip it"

    @property
    def possible(self) -> bool:
        """Whether the robot can walk the gait, clipped by the guard or not."""
        return self.demand.possible and self.verdict.possible

    @property
    def warnings(self) -> tuple[str, ...]:
        """Obstacles and warnings of the load, one sentence each."""
        return (*self.verdict.obstacles, *self.verdict.warnings)

    @property
    def gait_fits_servos(self) -> bool:
        """Whether all angles of the gait lie within the limits of the servos."""
        ends = (self.demand.lowest_rad, self.demand.highest_rad)
        return not any(bool(self.servo_map.outside(end).any()) for end in ends)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values, angles in degrees: the object of `hexctl check --json`."""
        robot, gait, demand = self.robot, self.gait, self.demand
        return {
            "robot": robot.name,
            "mass_kg": round(robot.mass_kg, 4),
            "standing_height_m": round(robot.standing_height_m, 4),
            "gait": {"slots": list(gait.slots), "code": gait.code(), "pace_hz": gait.pace_hz},
            "ideal_speed_m_s": round(ideal_speed_m_s(robot, gait, Motion()), 4),
            "max_pace_hz": None if demand.max_pace_hz is None else round(demand.max_pace_hz, 3),
            "speed_holds": demand.speed_reached,
            "unreachable_legs": list(demand.unreachable_legs),
            "joints_out_of_range": [JOINT_NAMES[joint] for joint in demand.limits_exceeded],
            "least_foot_spacing_m": round(demand.least_foot_spacing_m, 4),
            "feet_stay_apart": demand.least_foot_spacing_m > 2 * robot.foot_radius_m,
            "possible": self.possible,
            "sensors": list(robot.sensors),
            "detects": failures_shown(robot.sensors),
            "joints": self._joints(),
            "joints_without_stance": list(self._without_stance),
            "driver": self.driver,
            **self._servos(),
            "to_measure": list(self.to_measure),
            "meshes": list(self.mesh_parts),
            **self.load.to_dict(),
            **stance_width(robot, gait),
            "doubtful": self.verdict.doubtful,
            "warnings": list(self.warnings),
        }

    def _joints(self) -> dict[str, dict[str, float]]:
        angles = {
            "lowest_deg": self.demand.lowest_rad,
            "highest_deg": self.demand.highest_rad,
            "min_deg": self.robot.joint_lower_rad,
            "max_deg": self.robot.joint_upper_rad,
            "peak_speed_deg_s": self.demand.peak_speed_rad_s,
            "max_speed_deg_s": self.robot.joint_max_speed_rad_s,
            "sag_deg": self.load.deflections_rad,
        }
        loads = {
            "static_torque_nm": self.load.torques_nm,
            "max_torque_nm": self.robot.joint_max_torque_nm,
            "duty": self.load.duties,
        }
        columns = {key: np.degrees(values) for key, values in angles.items()} | loads
        places = {"static_torque_nm": 4, "max_torque_nm": 4}
        return {
            name: {key: round(float(values[joint]), places.get(key, 2)) for key, values in columns.items()}
            for joint, name in enumerate(JOINT_NAMES)
        }

    def _servos(self) -> dict[str, Any]:
        beyond, fits = list(joints_beyond(self.servo_map, self.robot)), self.gait_fits_servos
        if self.servo_map.unit == "us":
            return {
                "pulses_us": self._range_raw(),
                "joints_beyond_pulses": beyond,
                "gait_fits_pulses": fits,
            }
        return {
            "counts": self._range_raw(),
            "joints_beyond_counts": beyond,
            "joints_beyond_travel": list(joints_beyond_travel(self.servo_map, self.robot)),
            "gait_fits_counts": fits,
        }

    def _range_raw(self) -> dict[str, list[int]]:
        """Pulses or counts at both ends of each joint's range, the lower one first."""
        limits = (self.robot.joint_lower_rad, self.robot.joint_upper_rad)
        ends = [self.servo_map.raw(limit) for limit in limits]
        return {
            name: sorted(round(float(end[joint])) for end in ends) for joint, name in enumerate(JOINT_NAMES)
        }


def _slow(share: float) -> str:
    return f"slow: joints reach {100 * share:.0f} % of the speed of this gait, and their commands are clipped"


def _trunk_is_low(where: str) -> str:
    return f"trunk: its underside is {where}; see to `body.size_m` and a lower `stance.up_m`"


def check_robot(
    robot: str | Path = "ant",
    gait: str = DEFAULT_GAIT,
    *,
    heading_rad: float | None = None,
    turn_rate_rad_s: float | None = None,
    pace_hz: float | None = None,
    amplitude: float | None = None,
    height: float | None = None,
) -> RobotCheck:
    """Check whether a robot can walk a gait; None takes the robot's value.

    Args:
        gait: name, code or slots; `auto` is the most stable one.
        heading_rad: counter-clockwise from forward; None checks all round.
        turn_rate_rad_s: without a heading the robot turns in place.
        amplitude: stride as a fraction of the robot's size, as is the step height.

    Raises InputError for an invalid robot file, mesh or gait.
    """
    file = load_robot_file(robot)
    stable = most_stable_slots(file.robot, heading_rad=heading_rad or 0.0) if gait == AUTO else None
    checked = make_gait(
        file.robot, stable or gait, pace_hz=pace_hz, amplitude=amplitude, height=height, others=(AUTO,)
    )
    motions = _motions(heading_rad, turn_rate_rad_s)
    demand, load = gait_demand(file.robot, checked, motions), gait_load(file.robot, checked, motions)
    return RobotCheck(
        robot=file.robot,
        gait=checked,
        demand=demand,
        load=load,
        servo_map=raw_map_of(file),
        driver=file.content.servos.driver,
        to_measure=file.to_measure,
        mesh_parts=tuple(file.meshes),
        servos_given=file.content.servos != ServosSection(),
        unit_doubts=_unit_doubts(file.content, demand, load),
    )


def _unit_doubts(content: RobotSchema, demand: GaitDemand, load: GaitLoad) -> tuple[str, ...]:
    """Doubts about the units of a robot file; torque and speed are also compared with what the gait needs."""
    if doubts := unit_doubts(content):
        return tuple(doubts)
    slow = "" if demand.speed_reached else slowness_doubt(content)
    found = (mass_doubt(content, load.capacity), carried_doubt(content, load.capacity), slow)
    return tuple(each for each in found if each)


def _motions(heading_rad: float | None, turn_rate_rad_s: float | None) -> list[Motion]:
    if heading_rad is None and turn_rate_rad_s is not None:
        return [Motion(travel=0.0, turn_rate_rad_s=turn_rate_rad_s)]
    headings = HEADINGS_RAD if heading_rad is None else (heading_rad,)
    return [Motion(heading_rad=heading, turn_rate_rad_s=turn_rate_rad_s or 0.0) for heading in headings]
