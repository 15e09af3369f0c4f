"""Robot files: one YAML, parsed once, gives a frozen `Robot`, its servo map and its meshes."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import InputError
from hexctl.robot.configs import find_config, read_mapping, validate
from hexctl.robot.formats.link_masses import link_mass
from hexctl.robot.meshes import Meshes, read_meshes
from hexctl.robot.model import Robot, stance
from hexctl.robot.plausibility import mass_problem
from hexctl.robot.schema import P_GAIN, JointSection, LinkSection, RobotSchema
from hexctl.robot.sensors import SENSORS
from hexctl.robot.servos.servo_map import ServoMap, servo_map_of
from hexctl.robot.unit_doubts import unit_doubts
from hexctl.robot.yaml_text import with_values, yaml_content
from hexctl.types import JOINT_KINDS, JOINT_NAMES, N_LEGS, FloatArray


@dataclass(frozen=True)
class RobotFile:
    """A robot file; servo map and meshes are made, and checked, on first access."""

    path: Path
    robot: Robot
    content: RobotSchema
    p_gain: int | None = None
    """P gain for which the stiffness holds; None for a file without one."""

    @cached_property
    def servo_map(self) -> ServoMap:
        """The servo map of the section `servos`, or the default; raises InputError."""
        try:
            return servo_map_of(self.content.servos)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from error

    @property
    def to_measure(self) -> tuple[str, ...]:
        """Keys under `unknown` that no calibration has found for all six joints of their kind."""
        return tuple(path for path in self.content.unknown if not self._calibrated(path.split(".")))

    def _calibrated(self, path: list[str]) -> bool:
        if len(path) != 3 or path[0] != "servos" or path[1] not in JOINT_KINDS:
            return False
        joints = [getattr(self.content.servos, name) for name in JOINT_NAMES if name.endswith(path[1])]
        return all(getattr(joint, path[2]) is not None for joint in joints)

    @cached_property
    def meshes(self) -> Meshes:
        """The meshes of the section `meshes`; raises InputError for a missing or broken one."""
        return read_meshes(self.content.meshes, self.path)

    def text_in(self, folder: Path) -> str:
        """Text of the file for another folder, where relative paths of meshes begin; comments stay."""
        text, here = self.path.read_text(encoding="utf-8"), self.path.parent.resolve()
        mapping = yaml_content(text)
        meshes = {part: mesh for part, mesh in mapping.get("meshes", {}).items() if mesh is not None}
        moved = {
            part: mesh | {"file": os.path.relpath(here / mesh["file"], folder.resolve())}
            for part, mesh in meshes.items()
            if not Path(mesh["file"]).is_absolute()
        }
        return with_values(text, mapping | {"meshes": mapping["meshes"] | moved}) if moved else text


def load_robot_file(name_or_path: str | Path = "ant") -> RobotFile:
    """Robot file of a shipped name (`ant`, `phantomx`, `jethexa` ...) or of a path; raises InputError."""
    path = find_config("robots", name_or_path)
    return _robot_file(read_mapping(path), path)


def robot_of_content(content: dict[str, Any], path: Path) -> Robot:
    """Robot of the content of a robot file; raises what `load_robot_file` raises."""
    return _robot_file(content, path).robot


def _robot_file(content: dict[str, Any], path: Path) -> RobotFile:
    schema = validate(RobotSchema, content, path)
    try:
        gain = content["servo"].get(P_GAIN)
        return RobotFile(path, _build(schema), schema, None if gain is None else int(gain))
    except InputError as error:
        raise InputError("; ".join([f"{path}: {error}", *unit_doubts(schema)])) from error


def load_robot(name_or_path: str | Path = "ant", *, all_sensors: bool = False) -> Robot:
    """Robot of a robot file, by shipped name or path.

        print(hexctl.load_robot("phantomx").stance_angles_rad)

    With `all_sensors` its simulation measures everything. Raises what `load_robot_file` raises.
    """
    robot = load_robot_file(name_or_path).robot
    return replace(robot, sensors=SENSORS) if all_sensors else robot


def load_meshes(name_or_path: str | Path = "ant") -> Meshes:
    """Meshes of a robot file, by shipped name or path; also raises what `RobotFile.meshes` raises."""
    return load_robot_file(name_or_path).meshes


def _build(schema: RobotSchema) -> Robot:
    """Robot model of a valid file; raises InputError if the robot cannot stand."""
    links, joints = schema.links.each, schema.joints.each
    positions = np.array([mount.place_m for mount in schema.mounts])
    yaws = np.array([mount.yaw_rad for mount in schema.mounts])
    feet, angles = stance(positions, yaws, schema.links.ends_m, (schema.stance.outward_m, schema.stance.up_m))
    robot = Robot(
        name=schema.name,
        size_m=schema.size_m,
        body=schema.body,
        mount_positions_body=positions,
        mount_yaws_rad=yaws,
        link_vectors_m=np.array([link.end_m for link in links]),
        link_masses_kg=np.array([link.mass_kg for link in links]),
        link_radii_m=np.array([link.radius_m for link in links]),
        foot_radius_m=schema.foot_radius_m,
        joint_lower_rad=_per_joint([math.radians(joint.min_deg) for joint in joints]),
        joint_upper_rad=_per_joint([math.radians(joint.max_deg) for joint in joints]),
        joint_max_speed_rad_s=_per_joint([math.radians(joint.max_speed_deg_s) for joint in joints]),
        joint_max_torque_nm=_per_joint([joint.max_torque_nm for joint in joints]),
        stance_feet_body=feet,
        stance_angles_rad=angles,
        servo=schema.servo,
        gait=schema.gait,
        link_coms_m=_link_coms(links),
        joint_stiffness_nm_per_rad=_stiffness(schema, joints),
        joint_dry_friction_nm=_if_any([joint.dry_friction_nm for joint in joints]),
        joint_no_load_speed_rad_s=_if_any(
            [math.radians(joint.no_load_speed_deg_s or 0.0) for joint in joints]
        ),
        joint_play_rad=_if_any([math.radians(joint.play_deg) for joint in joints]),
        sensors=schema.measured,
    )
    _check_units(robot)
    _check_stance_limits(robot)
    _check_leg_order(robot)
    _check_foot_spacing(robot)
    return _with_link_inertias(robot, links)


def _with_link_inertias(robot: Robot, links: Sequence[LinkSection]) -> Robot:
    """The robot with the moments of its links, if any are given; others have those of their capsules."""
    given = [link.inertia_kg_m2 for link in links]
    if not any(given):
        return robot
    even = [link_mass(robot, index).link_moments_kg_m2 for index in range(len(links))]
    return replace(
        robot, link_inertias_kg_m2=np.array([own or usual for own, usual in zip(given, even, strict=True)])
    )


def _per_joint(values: list[float]) -> FloatArray:
    return np.tile(np.array(values), N_LEGS)


def _link_coms(links: Sequence[LinkSection]) -> FloatArray | None:
    """Centres of mass of the links, (3, 2), or None if all are in the middle."""
    if all(link.com_m is None for link in links):
        return None
    return np.array([np.array(link.end_m) / 2 if link.com_m is None else link.com_m for link in links])


def _stiffness(schema: RobotSchema, joints: Sequence[JointSection]) -> FloatArray | None:
    """Stiffness of each joint, (18,), or None if all have the servo's."""
    own = [joint.stiffness_nm_per_rad for joint in joints]
    usual = schema.servo.stiffness_nm_per_rad
    return _per_joint([one or usual for one in own]) if any(own) else None


def _if_any(values: list[float]) -> FloatArray | None:
    """Values of the three kinds for each joint, (18,), or None if all are 0."""
    return _per_joint(values) if any(values) else None


def _check_units(robot: Robot) -> None:
    lengths_m = robot.link_lengths_m.tolist()
    links = [
        (kg, (length_m, 0.0, 0.0))
        for kg, length_m in zip(robot.link_masses_kg.tolist(), lengths_m, strict=True)
    ]
    parts = {"body": (robot.body.mass_kg, robot.body.size_m), **dict(zip(JOINT_KINDS, links, strict=True))}
    if problem := mass_problem(parts, robot.mass_kg, sum(lengths_m)):
        raise InputError(f"body and links: {problem}")


def _check_stance_limits(robot: Robot) -> None:
    for index, name in enumerate(JOINT_NAMES):
        angle, low, high = (
            math.degrees(array[index])
            for array in (robot.stance_angles_rad, robot.joint_lower_rad, robot.joint_upper_rad)
        )
        if not low <= angle <= high:
            raise InputError(f"stance: needs {name} at {angle:.1f} deg; allowed: {low:g} to {high:g} deg")


def _check_leg_order(robot: Robot) -> None:
    gaps = np.diff(robot.leg_azimuths_rad, append=robot.leg_azimuths_rad[0]) % math.tau
    if not math.isclose(gaps.sum(), math.tau, rel_tol=1e-6):
        degrees = ", ".join(f"{azimuth:.0f}" for azimuth in np.degrees(robot.leg_azimuths_rad))
        raise InputError(
            f"mounts: the feet stand at azimuths {degrees} deg; "
            "allowed: counter-clockwise from leg 1 to leg 6"
        )


def _check_foot_spacing(robot: Robot) -> None:
    spacing = np.linalg.norm(robot.stance_feet_body - np.roll(robot.stance_feet_body, -1, axis=0), axis=-1)
    leg = int(spacing.argmin()) + 1
    least = 2 * robot.foot_radius_m
    if spacing.min() < least:
        raise InputError(
            f"mounts: feet {leg} and {leg % N_LEGS + 1} stand {spacing.min():.4f} m apart; "
            f"allowed: {least:g} m or more"
        )
