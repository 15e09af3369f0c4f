"""A robot file from a third-party URDF."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hexctl.errors import InputError, argument
from hexctl.robot.formats.urdf_legs import UrdfLeg, check_alike, find_legs
from hexctl.robot.formats.urdf_tree import UrdfTree, read_urdf
from hexctl.robot.loader import robot_of_content
from hexctl.robot.model import Vector2, leg_reach_m, stance_angles
from hexctl.types import JOINT_KINDS, FloatArray

#: The robot's front in the frame of the root, and the turn about z to x.
FORWARD = {"x": 0.0, "y": -math.pi / 2, "-x": math.pi, "-y": math.pi / 2}

# Listed as unknown, and used for missing or implausible numbers: a typical servo of robots of this size.
USUAL_MASS_KG = {"body": 1.0, "coxa": 0.03, "femur": 0.07, "tibia": 0.08}
USUAL_TORQUE_NM, USUAL_SPEED_DEG_S, USUAL_RANGE_DEG = 1.5, 200.0, 90.0
USUAL_HEIGHT_M, USUAL_RADIUS_M, USUAL_FOOT_M = 0.05, 0.010, 0.008
#: Torques and speeds beyond which a number is a placeholder.
MOST_TORQUE_NM, MOST_SPEED_RAD_S = 60.0, 60.0
#: A root this far below or above the coxae is not in the trunk.
FAR_ROOT_M = 0.03
#: A lighter part is a placeholder.
LEAST_MASS_KG = 0.001
#: A wider range is that of a motor, not of a leg.
WIDEST_DEG = 170.0


@dataclass(frozen=True, slots=True)
class ImportedRobot:
    """A robot file made from a URDF, with the unknown keys, and notes on omissions and changes."""

    text: str
    unknown: tuple[str, ...]
    notes: tuple[str, ...]


def import_urdf(
    path: Path | str,
    *,
    name: str | None = None,
    foot_m: tuple[float, float, float] | None = None,
    forward: str = "x",
) -> ImportedRobot:
    """Make a robot file of a URDF with six legs of three hinges.

    Legs are recognised by their geometry, and numbered counter-clockwise from the front left. Missing values
    are typical ones, and listed under `unknown`.

    Args:
        path: the URDF; expand a xacro first.
        name: of the robot; None takes that of the URDF.
        foot_m: position of the feet in the frames of the last links, if the URDF lacks it.
        forward: the robot's front in the frame of its root: `x`, `y`, `-x` or `-y`.

    Raises InputError for anything that differs from such a robot, or is missing.
    """
    if forward not in FORWARD:
        raise InputError(f"{argument('forward')}: got {forward}; allowed: {', '.join(FORWARD)}")
    if name is not None and name != _short_name(name):
        raise InputError(f"{argument('name')}: got {name}; allowed: small letters, figures and dashes")
    tree = read_urdf(Path(path))
    facing = np.eye(4)
    cos, sin = math.cos(FORWARD[forward]), math.sin(FORWARD[forward])
    facing[:2, :2] = [[cos, -sin], [sin, cos]]
    legs = find_legs(tree, facing, None if foot_m is None else np.array(foot_m))
    check_alike(legs)
    return _Import(tree, legs, facing).robot(name or _short_name(tree.name), Path(path).name)


class _Import:
    def __init__(self, tree: UrdfTree, legs: list[UrdfLeg], facing: FloatArray) -> None:
        self._tree, self._legs, self._facing = tree, legs, facing
        self._unknown: list[str] = []
        self._notes: list[str] = []
        self._vectors_m = np.mean([leg.vectors_m for leg in legs], axis=0)
        height_m = float(np.mean([leg.mount_m[2] for leg in legs]))
        # A root at the floor is no body frame: the trunk's box would be there.
        self._height_m = height_m if abs(height_m) > FAR_ROOT_M else 0.0
        if not all(leg.foot_known for leg in legs):
            self._unknown.append("links.tibia.end_m")

    def robot(self, name: str, source: str) -> ImportedRobot:
        joints = {kind: self._joint(index) for index, kind in enumerate(JOINT_KINDS)}
        links = {kind: self._link(index) for index, kind in enumerate(JOINT_KINDS)}
        stance = self._stance(joints)
        torque_nm = min(joint["max_torque_nm"] for joint in joints.values())
        reach_m = stance["outward_m"]
        content = {
            "name": name,
            "description": f"imported from {source}",
            "size_m": 1.0,
            "body": self._body(),
            "mounts": [self._mount(leg) for leg in self._legs],
            "links": links,
            "foot_radius_m": self._foot_radius_m(),
            "joints": joints,
            "stance": stance,
            # Full torque at about 5 degrees of error, as common digital servos are set.
            "servo": {
                "stiffness_nm_per_rad": _short(torque_nm / 0.085),
                "damping_nm_s_per_rad": _short(torque_nm / 0.085 * 0.02),
                "rotor_inertia_kg_m2": _short(0.002 * max(1.0, torque_nm / 1.5)),
            },
            "gait": {"pace_hz": 0.5, "amplitude": _short(0.45 * reach_m), "height": _short(0.15 * reach_m)},
        }
        unknown = tuple(self._unknown)
        if unknown:
            content["unknown"] = list(unknown)
        robot_of_content(content, Path(source))
        text = "".join(f"# {line}\n" for line in self._header(source)) + _yaml(content)
        return ImportedRobot(text, unknown, tuple(self._notes))

    def _header(self, source: str) -> list[str]:
        lines = [f"From {source}. Joints there, and in brackets those that count the other way:"]
        for number, leg in enumerate(self._legs, start=1):
            names = [
                joint.name if sign > 0 else f"({joint.name})"
                for joint, sign in zip(leg.joints, leg.signs, strict=True)
            ]
            lines.append(f"  leg {number}: {', '.join(names)}")
        if self._height_m:
            lines.append(f"The body frame is {self._height_m:.4f} m above that of {self._tree.root}.")
        return lines

    def _mount(self, leg: UrdfLeg) -> dict[str, Any]:
        x, y, z = leg.mount_m.tolist()
        position = [_short(x, 5), _short(y, 5), _short(z - self._height_m, 5)]
        return {"position_m": position, "yaw_deg": _short(math.degrees(leg.yaw_rad), 3)}

    def _body(self) -> dict[str, Any]:
        """The trunk: all links that no leg carries, as a box."""
        tree = self._tree
        carried = {name for leg in self._legs for joint in leg.joints for name in tree.rigid(joint.child)}
        links = [tree.links[name] for name in tree.links if name not in carried]
        masses_kg = [link.mass_kg or 0.0 for link in links]
        mass_kg = sum(masses_kg)
        if mass_kg < LEAST_MASS_KG:
            self._unknown.append("body.mass_kg")
            mass_kg, com_m = USUAL_MASS_KG["body"], np.zeros(3)
        else:
            coms_m = [(self._facing @ tree.placed(link.name) @ [*link.com_m, 1.0])[:3] for link in links]
            com_m = np.average(coms_m, axis=0, weights=masses_kg) - [0, 0, self._height_m]
        size_m = self._body_size_m([link.name for link in links])
        if (np.abs(com_m) > np.array(size_m)).any():
            self._notes.append("the trunk's centre of mass lies outside it and was left out")
            com_m = np.zeros(3)
        body: dict[str, Any] = {"shape": "box", "size_m": [_short(side) for side in size_m]}
        body["mass_kg"] = _short(mass_kg)
        if np.abs(com_m).max() > 1e-4:
            body["com_m"] = [_short(part, 4) for part in com_m]
        return body

    def _body_size_m(self, names: list[str]) -> list[float]:
        """Length, width and height: of its largest box or cylinder, else of the area between the mounts."""
        solids = [
            (name, shape)
            for name in names
            for shape in self._tree.links[name].shapes
            if shape.kind in ("box", "cylinder") and max(shape.size_m) > 0.03
        ]
        if solids:
            name, shape = max(solids, key=lambda one: math.prod(one[1].size_m))
            sides = shape.size_m if shape.kind == "box" else (*[2 * shape.size_m[0]] * 2, shape.size_m[1])
            turn = (self._facing @ self._tree.placed(name) @ shape.frame)[:3, :3]
            return [float(side) for side in np.abs(turn) @ np.array(sides)]
        self._unknown.append("body.size_m")
        mounts_m = np.array([leg.mount_m for leg in self._legs])
        return [max(float(np.ptp(mounts_m[:, axis])), 0.05) for axis in (0, 1)] + [USUAL_HEIGHT_M]

    def _link(self, index: int) -> dict[str, Any]:
        kind, tree = JOINT_KINDS[index], self._tree
        masses_kg, coms_m = [], []
        for leg in self._legs:
            names = tree.rigid(leg.joints[index].child)
            own_kg = [tree.links[name].mass_kg or 0.0 for name in names]
            masses_kg.append(sum(own_kg))
            if sum(own_kg) >= LEAST_MASS_KG:
                joint_m = (self._facing @ tree.placed(leg.joints[index].child))[:3, 3]
                places_m = [
                    (self._facing @ tree.placed(name) @ [*tree.links[name].com_m, 1.0])[:3] - joint_m
                    for name in names
                ]
                com = np.average(places_m, axis=0, weights=own_kg)
                outward = [math.cos(leg.yaw_rad), math.sin(leg.yaw_rad), 0.0]
                coms_m.append([float(com @ outward), float(com[2])])
        mass_kg = float(np.mean(masses_kg))
        if mass_kg < LEAST_MASS_KG:
            self._unknown.append(f"links.{kind}.mass_kg")
            mass_kg = USUAL_MASS_KG[kind]
        end_m = self._vectors_m[index]
        link: dict[str, Any] = {"end_m": [_short(part, 5) for part in end_m], "mass_kg": _short(mass_kg)}
        link["radius_m"] = _short(self._radius_m(index))
        length_m = float(np.linalg.norm(end_m))
        if coms_m:
            com_m = np.mean(coms_m, axis=0)
            # A centre of mass in the joint is a placeholder.
            if 1e-4 < np.linalg.norm(com_m) < 1.5 * length_m:
                link["com_m"] = [_short(part, 4) for part in com_m]
        return link

    def _radius_m(self, index: int) -> float:
        shapes = self._tree.links[self._legs[0].joints[index].child].shapes
        radii_m = [shape.size_m[0] for shape in shapes if shape.kind == "cylinder"]
        length_m = float(np.linalg.norm(self._vectors_m[index]))
        return min(radii_m[0] if radii_m else USUAL_RADIUS_M, 0.45 * length_m)

    def _foot_radius_m(self) -> float:
        links = [self._tree.links[name] for name in self._legs[0].tips]
        spheres = [shape for link in links for shape in link.shapes if shape.kind == "sphere"]
        if not spheres:
            self._unknown.append("foot_radius_m")
            return USUAL_FOOT_M
        return _short(min(spheres[-1].size_m[0], 0.03))

    def _joint(self, index: int) -> dict[str, Any]:
        kind = JOINT_KINDS[index]
        low_deg, high_deg = self._range_deg(index)
        torques_nm = [leg.joints[index].torque_nm for leg in self._legs]
        speeds_rad_s = [leg.joints[index].speed_rad_s for leg in self._legs]
        torque_nm = min((one for one in torques_nm if one and 0 < one <= MOST_TORQUE_NM), default=None)
        speed_rad_s = min((one for one in speeds_rad_s if one and 0 < one <= MOST_SPEED_RAD_S), default=None)
        if torque_nm is None:
            self._unknown.append(f"joints.{kind}.max_torque_nm")
        if speed_rad_s is None:
            self._unknown.append(f"joints.{kind}.max_speed_deg_s")
        speed_deg_s = USUAL_SPEED_DEG_S if speed_rad_s is None else math.degrees(speed_rad_s)
        return {
            "min_deg": low_deg,
            "max_deg": high_deg,
            "max_speed_deg_s": _short(speed_deg_s),
            "max_torque_nm": _short(torque_nm or USUAL_TORQUE_NM),
        }

    def _range_deg(self, index: int) -> tuple[float, float]:
        kind, ranges = JOINT_KINDS[index], []
        for leg in self._legs:
            joint, sign = leg.joints[index], leg.signs[index]
            if joint.kind == "revolute" and joint.limits_rad is not None:
                ranges.append(sorted(math.degrees(sign * end) for end in joint.limits_rad))
        lows, highs = [low for low, _ in ranges], [high for _, high in ranges]
        low, high = max(lows, default=-180.0), min(highs, default=180.0)
        if ranges and max(np.ptp(lows), np.ptp(highs)) > 1:
            self._notes.append(f"the {kind} joints have other ranges on other legs; what all allow was taken")
        if high - low < 1 or not low < high:
            raise InputError(f"urdf: the {kind} joints allow {low:.0f} to {high:.0f} deg in common")
        if high - low >= 2 * WIDEST_DEG or len(ranges) < len(self._legs):
            self._unknown += [f"joints.{kind}.min_deg", f"joints.{kind}.max_deg"]
            return -USUAL_RANGE_DEG, USUAL_RANGE_DEG
        return _short(max(low, -180.0), 3), _short(min(high, 180.0), 3)

    def _stance(self, joints: dict[str, dict[str, Any]]) -> dict[str, float]:
        """A stance with a nearly level femur and a steep tibia; raises InputError if there is none."""
        coxa, femur, tibia = ((float(one[0]), float(one[1])) for one in self._vectors_m)
        least, most = leg_reach_m(femur, tibia)
        lengths = math.hypot(*femur), math.hypot(*tibia)
        best, wanted = None, (math.radians(20), math.radians(-75))
        for femur_rad in np.radians(np.arange(-40, 81, 5)):
            for tibia_rad in np.radians(np.arange(-110, -29, 5)):
                foot = (
                    coxa[0] + lengths[0] * math.cos(femur_rad) + lengths[1] * math.cos(tibia_rad),
                    coxa[1] + lengths[0] * math.sin(femur_rad) + lengths[1] * math.sin(tibia_rad),
                )
                if not least < math.hypot(foot[0] - coxa[0], foot[1] - coxa[1]) < most or foot[0] < 0.02:
                    continue
                room_deg = self._room_deg(joints, (coxa, femur, tibia), foot)
                off = math.hypot(femur_rad - wanted[0], tibia_rad - wanted[1])
                cost = off + max(0.0, math.radians(15 - room_deg)) * 4
                if room_deg > 0 and foot[1] < -0.02 and (best is None or cost < best[0]):
                    best = (cost, foot)
        if best is None:
            raise InputError("urdf: its joints have no stance in which the feet are below the body")
        return {"outward_m": _short(best[1][0]), "up_m": _short(best[1][1])}

    def _room_deg(
        self, joints: dict[str, dict[str, Any]], links: tuple[Vector2, Vector2, Vector2], foot: Vector2
    ) -> float:
        """Distance of the nearest limit from the angles that put the foot there, negative beyond it."""
        coxa, femur, tibia = links
        try:
            angles_deg = [math.degrees(angle) for angle in stance_angles(coxa, femur, tibia, foot)]
        except (InputError, ValueError):  # out of reach, or stretched to the last digit
            return -math.inf
        room_deg = [
            min(angle - joints[kind]["min_deg"], joints[kind]["max_deg"] - angle)
            for kind, angle in zip(("femur", "tibia"), angles_deg, strict=True)
        ]
        return float(min(room_deg))


def _short_name(text: str) -> str:
    name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:40]
    return name or "robot"


def _short(value: float, digits: int = 4) -> float:
    """Rounded to decimal places, without a negative zero."""
    return round(float(value), digits) + 0.0


class _Flow(dict[str, Any]):
    """A mapping on one line."""


class _Dumper(yaml.SafeDumper):
    """Writes each entry of a section on one line."""


_Dumper.add_representer(
    _Flow, lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", data, flow_style=True)
)
_Dumper.add_representer(
    list,
    lambda dumper, data: dumper.represent_sequence(
        "tag:yaml.org,2002:seq", data, flow_style=not any(isinstance(one, dict) for one in data)
    ),
)


def _yaml(content: dict[str, Any]) -> str:
    laid: dict[str, Any] = {}
    for key, value in content.items():
        if key in ("links", "joints"):
            laid[key] = {name: _Flow(part) for name, part in value.items()}
        elif key == "mounts":
            laid[key] = [_Flow(part) for part in value]
        else:
            laid[key] = _Flow(value) if isinstance(value, dict) else value
    return yaml.dump(laid, Dumper=_Dumper, sort_keys=False, width=1000, allow_unicode=True)
