"""A robot file from a third-party robot description, URDF or MJCF."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import InputError, argument, printable
from hexctl.files import read_file
from hexctl.robot.formats.importing.import_values import Findings, least_mass_kg, rounded
from hexctl.robot.formats.importing.leg_chains import (
    AXIS_TOLERANCE_RAD,
    fixed_text,
    leg_chains,
    with_three_hinges,
)
from hexctl.robot.formats.importing.leg_import import LegImport
from hexctl.robot.formats.importing.leg_names import FORWARD, forward_by_names
from hexctl.robot.formats.importing.link_tree import MOST_BYTES, LinkTree, joined_mass
from hexctl.robot.formats.importing.mjcf_process import read_mjcf
from hexctl.robot.formats.importing.tree_legs import (
    FootProjection,
    TreeLeg,
    find_legs,
    with_middle_coxae,
    with_one_zero,
)
from hexctl.robot.formats.importing.trunk_import import body_origin, body_section, trunk_box
from hexctl.robot.formats.importing.urdf_tree import read_urdf
from hexctl.robot.formats.link_masses import link_mass
from hexctl.robot.formats.mjcf import GAIT_KEY, SIZE_KEY
from hexctl.robot.loader import robot_of_content
from hexctl.robot.model import Robot, Vector2, leg_reach_m, stance_angles
from hexctl.robot.plausibility import mass_problem
from hexctl.robot.schema import NAME
from hexctl.robot.yaml_text import yaml_lines
from hexctl.types import JOINT_KINDS, N_LEGS, FloatArray

#: Default pace, and stride and step height as shares of the feet's distance from the coxae.
USUAL_PACE_HZ, USUAL_STRIDE, USUAL_STEP = 0.5, 0.45, 0.15

#: Legs that span so many times more from side to side than ahead hint at another front.
ALONG_Y = 1.3

#: Difference of the robot's mass from the file's that rounding explains, as a share.
SAME_MASS = 1e-4

#: Minimum distances of the feet outward and below the coxa axes in a stance, as a share of the legs.
LEAST_FOOT = 0.08

#: A stance with a nearly level femur and a steep tibia, and the room that its joints are to have.
TARGET_SLOPES_RAD, TARGET_ROOM_RAD = (math.radians(20), math.radians(-75)), math.radians(15)


@dataclass(frozen=True, slots=True)
class ImportedRobot:
    """A robot file made from a description.

    Attributes:
        content: of the robot file.
        reasons: why keys are unknown, by key.
        remarks: on omissions and changes.
        header: lines of a comment.
        stances: places for the feet in the planes of the legs, (outward, up) in m: that of the content, then
            others, the best first.
        projection: of feet next to these planes.
        own_gait: whether the default gait is that of the description.
    """

    content: dict[str, Any]
    reasons: dict[str, str]
    remarks: tuple[str, ...]
    header: tuple[str, ...]
    stances: tuple[Vector2, ...]
    projection: FootProjection | None = None
    own_gait: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on omissions and changes, and on the error of projected feet in the gait of the content."""
        if self.projection is None:
            return self.remarks
        stride_m = self.content["gait"]["amplitude"] * self.content["size_m"]
        return (*self.remarks, self.projection.note(self.stances[0][0], stride_m))

    @property
    def unknown(self) -> tuple[str, ...]:
        """Keys whose values are guesses."""
        return tuple(self.reasons)

    @property
    def text(self) -> str:
        """The robot file."""
        content = self.content | ({"unknown": list(self.unknown)} if self.reasons else {})
        reasons = ("Unknown, with the reasons:", *(f"  {key}: {why}" for key, why in self.reasons.items()))
        lines = (*self.header, *(reasons if self.reasons else ()))
        return "".join(f"# {printable(line)}\n" for line in lines) + yaml_lines(content)

    def robot(self) -> Robot:
        """The robot of the file; raises InputError if it is not allowed."""
        return robot_of_content(self.content, Path(self.content["name"]))

    def with_gait(self, stance: Vector2, pace_hz: float, stride_m: float, step_m: float) -> "ImportedRobot":
        """The same robot with another stance, in the planes of its legs, and another default gait."""
        size_m, (outward_m, up_m) = self.content["size_m"], stance
        gait = {"pace_hz": pace_hz, "amplitude": stride_m / size_m, "height": step_m / size_m}
        changed: dict[str, Any] = {"gait": {key: rounded(value) for key, value in gait.items()}}
        if self.projection is not None:
            changed |= self.projection.sections(self.content, outward_m)
            outward_m = self.projection.outward_m(outward_m)
        changed["stance"] = {"outward_m": rounded(outward_m), "up_m": rounded(up_m)}
        stances = (stance, *(other for other in self.stances if other != stance))
        return replace(self, content=self.content | changed, stances=stances)

    def with_gait_values(self, **values: float) -> "ImportedRobot":
        """The same robot with other values in the section `gait`."""
        gait = self.content["gait"] | {key: rounded(value) for key, value in values.items()}
        return replace(self, content=self.content | {"gait": gait})


def import_robot(
    path: Path | str,
    *,
    name: str | None = None,
    foot_m: tuple[float, float, float] | None = None,
    forward: str | None = None,
) -> ImportedRobot:
    """Make a robot file of a URDF or an MJCF with six legs of three hinges.

    Legs are recognised by their geometry, and numbered counter-clockwise from the front left. The vertical is
    that of the coxa axes. Missing and implausible values are typical ones, and listed as unknown.

    Args:
        path: the description; expand a xacro first.
        name: of the robot; None takes that of the description.
        foot_m: position of the feet in the frames of the last links, if the description lacks it.
        forward: the robot's front in the frame of its root: `x`, `y`, `-x` or `-y`; None for that of the
            names of its legs, if they tell side or end, else `x`.

    Raises InputError for anything that differs from such a robot, or is missing.
    """
    if forward not in (None, *FORWARD):
        raise InputError(f"{argument('forward')}: got {forward}; allowed: {', '.join(FORWARD)}")
    if name is not None and not re.fullmatch(NAME, name):
        raise InputError(
            f"{argument('name')}: got {name}; allowed: up to 40 lower case letters, digits, hyphens and "
            "underscores, first a letter or digit"
        )
    tree, fixed_rad = with_three_hinges(_read(Path(path)))
    made = _imports(tree, fixed_rad, forward, None if foot_m is None else np.array(foot_m))
    chosen = next((one for one in made if one.stances), None)
    if chosen is None:
        raise InputError(
            f"{path}: its joints have no stance in which the feet are below the body; allowed: a robot that "
            f"can stand ({made[0].why_no_stance()})"
        )
    return chosen.robot(name or _short_name(tree.name), Path(path).name)


def _imports(
    tree: LinkTree, fixed_rad: Mapping[str, float], forward: str | None, foot_m: FloatArray | None
) -> "list[_Import]":
    """Imports for both directions of the vertical: first the root's z axis, or else away from the feet."""
    fronts = _fronts(tree, forward)
    facings = [front.frame for front in fronts]
    legs = [with_middle_coxae(with_one_zero(find_legs(tree, facing, foot_m))) for facing in facings]
    made = [_Import(tree, one, front, fixed_rad) for one, front in zip(legs, fronts, strict=True)]
    if facings[0][2, 2] < math.cos(AXIS_TOLERANCE_RAD):
        made.sort(key=lambda one: one.feet_up_m)
    return made


def _read(path: Path) -> LinkTree:
    try:
        start = read_file(path, MOST_BYTES)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); allowed: a URDF or an MJCF") from error
    tag = re.search(rb"<\s*([A-Za-z][\w:]*)", re.sub(rb"<!--(?:.*?-->|.*)", b"", start, flags=re.DOTALL))
    return read_mjcf(path) if tag is not None and tag[1] == b"mujoco" else read_urdf(path)


@dataclass(frozen=True, slots=True, eq=False)
class _Front:
    """A front of the robot.

    Attributes:
        frame: transform from the root to axes of the body, (4, 4).
        named: keys of `FORWARD` by the names of the legs: by ends, then by sides if these contradict.
        axis: key of `FORWARD` that was taken.
    """

    frame: FloatArray
    named: Sequence[str]
    axis: str

    @property
    def note(self) -> str:
        """Note on a front that the names alone show, or contradict; empty for x by name."""
        if len(self.named) > 1:
            ends, sides = self.named
            return (
                f"the names of the legs contradict: their ends are those of --forward {ends}, their sides "
                f"those of --forward {sides}; the front is {self.axis}"
            )
        if not self.named or (*self.named, self.axis) == ("x", "x"):
            return ""
        if self.named[0] == self.axis:
            return f"the front is {self.axis}, as the names of the legs show (--forward {self.axis})"
        return f"the front is {self.axis}; by the names of the legs it is --forward {self.named[0]}"


def _fronts(tree: LinkTree, forward: str | None) -> list[_Front]:
    """Fronts for both directions of the vertical; the first has z up, if that is the root's vertical."""
    chains = leg_chains(tree)
    axes = np.array([tree.axis_in_root(chain[0]) for chain in chains])
    axes *= np.sign(axes @ axes[0] + 1e-12)[:, np.newaxis]
    axis = axes.mean(axis=0) / max(float(np.linalg.norm(axes.mean(axis=0))), 1e-12)
    up = axis * math.copysign(1.0, axis[np.abs(axis).argmax()])
    if up[2] > math.cos(AXIS_TOLERANCE_RAD):
        up = np.array([0.0, 0.0, 1.0])
    mounts_m = np.array([tree.frame_in_root(chain[0].child)[:3, 3] for chain in chains])
    names = [[*(joint.name for joint in chain), *tree.carried(chain[0].child)] for chain in chains]
    named = [forward_by_names(names, mounts_m - mounts_m.mean(axis=0), side * up) for side in (1, -1)]
    taken = [forward or (one[0] if len(one) == 1 else "x") for one in named]
    upright = (key for key in taken if abs(np.array(FORWARD[key]) @ up) > math.cos(math.radians(10)))
    if (vertical := next(upright, None)) is not None:
        raise InputError(
            f"{argument('forward')}: got {vertical}, which is the vertical of this robot; allowed: "
            f"{'y or -y' if 'x' in vertical else 'x or -x'}"
        )
    return [
        _Front(_facing(side * up, np.array(FORWARD[axis])), by_name, axis)
        for side, by_name, axis in zip((1, -1), named, taken, strict=True)
    ]


def _facing(up: FloatArray, ahead: FloatArray) -> FloatArray:
    front = ahead - (ahead @ up) * up
    front /= np.linalg.norm(front)
    facing = np.eye(4)
    facing[:3, :3] = front, np.cross(up, front), up
    return facing


class _Import:
    def __init__(
        self, tree: LinkTree, legs: list[TreeLeg], front: _Front, fixed_rad: Mapping[str, float]
    ) -> None:
        facing = front.frame
        self._tree, self._legs, self._facing, self._fixed_rad = tree, legs, facing, fixed_rad
        self._findings = Findings()
        if fixed_rad:
            self._findings.notes.append(
                f"the legs have {len(JOINT_KINDS) + len(fixed_rad) // len(legs)} hinges, of which hexctl "
                f"moves {len(JOINT_KINDS)}: hold {fixed_text(fixed_rad)}; to hold others, make those `fixed` "
                "in the description"
            )
        self._parts = LegImport(tree, legs, facing, self._findings)
        self._links, self._joints = self._parts.links(), self._parts.joints()
        mounts_m = np.array([leg.mount_m for leg in legs])
        #: Height of the feet above the coxae at angle zero.
        self.feet_up_m = float(np.mean([leg.foot_m[2] - leg.mount_m[2] for leg in legs]))
        self._box = trunk_box(tree, facing, mounts_m, self._parts.leg_m)
        self._origin_m = body_origin(self._box, mounts_m)
        length_m, width_m = np.ptp(mounts_m[:, :2], axis=0).tolist()
        if front.note:
            self._findings.notes.append(front.note)
        elif not front.named and width_m > ALONG_Y * length_m:
            self._findings.notes.append(
                f"the mounts span {width_m:.2g} m from side to side and {length_m:.2g} m ahead: if the robot "
                "looks along its longer side, give its front with --forward"
            )
        trunk = tree.carried(tree.root, *(leg.joints[0].child for leg in legs))
        self._trunk = [tree.links[name] for name in trunk]
        self._trunk_mass = joined_mass(self._trunk, [facing @ tree.frame_in_root(name) for name in trunk])
        self._check_units()
        self._note_other_hinges()
        self._mount_up_m = float(mounts_m[:, 2].mean() - self._origin_m[2])
        self.stances = self._stances()

    def robot(self, name: str, source: str) -> ImportedRobot:
        """The robot file; raises InputError if it is none."""
        servo = self._parts.servo(self._joints)
        body = body_section(
            self._trunk,
            self._trunk_mass,
            self._box,
            self._origin_m,
            self._findings,
            least_kg=self._parts.least_mass_kg,
            usual=self._parts.usual_masses,
        )
        projection = FootProjection.of(self._legs)
        outward_m = self.stances[0][0]
        if projection is not None:
            outward_m = projection.outward_m(outward_m)
        mounts = [self._mount(leg) for leg in self._legs]
        radius_m = max(math.hypot(*mount["position_m"][:2]) for mount in mounts) + outward_m
        gait = (USUAL_PACE_HZ, USUAL_STRIDE * outward_m, USUAL_STEP * outward_m)
        numbers = self._tree.numbers
        size_m = float(f"{2 * radius_m:.2g}")
        own_gait = min(numbers.get(SIZE_KEY, ()), default=0.0) > 0 and len(numbers.get(GAIT_KEY, ())) == 3
        if own_gait:
            size_m, (pace_hz, *shares) = numbers[SIZE_KEY][0], numbers[GAIT_KEY]
            gait = (pace_hz, shares[0] * size_m, shares[1] * size_m)
        content = {
            "name": name,
            "description": f"imported from {source}",
            "size_m": size_m,
            "body": body,
            "mounts": mounts,
            "links": self._links,
            "foot_radius_m": self._parts.foot_radius_m(),
            "joints": self._joints,
            "stance": {},
            "servo": servo,
            "gait": {},
        }
        raw = ImportedRobot(content, {}, (), tuple(self._header(source)), self.stances, projection, own_gait)
        made = raw.with_gait(self.stances[0], *gait)
        self._drop_plain_coms(made.content, Path(source))
        self._add_inertias(made.robot())
        made = raw.with_gait(self.stances[0], *gait)
        self._note_masses(robot_of_content(made.content, Path(source)).mass_kg)
        return replace(made, reasons=self._findings.reasons, remarks=tuple(self._findings.notes))

    def _check_units(self) -> None:
        """Raise InputError if masses and lengths do not fit together; placeholders do not count."""
        parts = {"trunk": (self._trunk_mass.mass_kg, tuple(self._box.size_m)), **self._parts.dense_parts()}
        robot_kg: float | None = parts["trunk"][0] + N_LEGS * sum(kg for kg, _ in list(parts.values())[1:])
        leg_m = self._parts.leg_m
        if min(kg for kg, _ in parts.values()) < least_mass_kg(leg_m):
            robot_kg = None
        if problem := mass_problem(parts, robot_kg, leg_m):
            raise InputError(f"robot description: {problem}")

    def _note_other_hinges(self) -> None:
        """Name the hinges of heads and arms: they stay at zero, and their masses are the trunk's."""
        joints = (self._tree.joints.get(link.name) for link in self._trunk)
        hinges = [joint.name for joint in joints if joint and joint.hinge]
        if hinges:
            self._findings.notes.append(
                f"hexctl does not move {', '.join(hinges)}: keep them at zero; what they carry belongs to "
                "the trunk"
            )

    def _note_masses(self, mass_kg: float) -> None:
        """Name the difference of the robot's mass from the sum of all masses in the file."""
        left_out = self._tree.left_out_kg
        file_kg = sum(link.mass_kg or 0.0 for link in self._tree.links.values()) + sum(left_out.values())
        if abs(mass_kg - file_kg) <= SAME_MASS * file_kg:
            return
        why = [f"{name}, {kg:.4g} kg, was left out" for name, kg in left_out.items()]
        why += [f"{key} was assumed" for key in self._findings.reasons if key.endswith("mass_kg")]
        self._findings.notes.append(
            f"the masses in the file add up to {file_kg:.4g} kg, those of the robot to {mass_kg:.4g} kg: "
            f"{', '.join(why)}"
        )

    def _drop_plain_coms(self, content: dict[str, Any], source: Path) -> None:
        """Leave out centres of mass equal to those of evenly filled capsules."""
        bare = {
            kind: {key: value for key, value in link.items() if key != "com_m"}
            for kind, link in self._links.items()
        }
        robot = robot_of_content(content | {"links": bare}, source)
        for index, link in enumerate(self._links.values()):
            x, _, z = link_mass(robot, index).com_m
            if not np.allclose(link.get("com_m", (x, z)), (x, z), atol=1e-6):
                return
        for link in self._links.values():
            link.pop("com_m", None)

    def _add_inertias(self, robot: Robot) -> None:
        for index, kind in enumerate(JOINT_KINDS):
            inertia = self._parts.inertia(index, link_mass(robot, index).link_moments_kg_m2)
            if inertia is not None:
                self._links[kind]["inertia_kg_m2"] = inertia

    def _header(self, source: str) -> list[str]:
        lines = [f"From {source}. Joints there, and in brackets those that count the other way:"]
        for number, leg in enumerate(self._legs, start=1):
            names = [
                (joint.name if sign > 0 else f"({joint.name})") + _zero_text(zero_rad)
                for joint, sign, zero_rad in zip(leg.joints, leg.signs, leg.zeros_rad, strict=True)
            ]
            lines.append(f"  leg {number}: {', '.join(names)}")
        if self._fixed_rad:
            lines.append(f"Not moved, to be held: {fixed_text(self._fixed_rad)}.")
        if np.abs(self._origin_m).max() > 1e-6:
            x, y, z = (np.linalg.inv(self._facing)[:3, :3] @ self._origin_m).tolist()
            lines.append(f"The body frame is at {x:.4f}, {y:.4f}, {z:.4f} m in that of {self._tree.root}.")
        return lines

    def _mount(self, leg: TreeLeg) -> dict[str, Any]:
        position = [rounded(part) for part in leg.mount_m - self._origin_m]
        return {"position_m": position, "yaw_deg": rounded(math.degrees(leg.yaw_rad))}

    def _stances(self) -> tuple[Vector2, ...]:
        """Places of the feet, (outward from the coxa axis, up from the body frame): the file's, then others.

        The best have a nearly level femur and a steep tibia.
        """
        coxa, femur, tibia = self._vectors()
        grid = np.radians(np.meshgrid(np.arange(-40, 81, 5), np.arange(-110, -29, 5), indexing="ij"))
        places, least_m = [], LEAST_FOOT * self._parts.leg_m
        for femur_rad, tibia_rad in grid.reshape(2, -1).T.tolist():
            foot = _place((coxa, femur, tibia), femur_rad, tibia_rad)
            room_rad = self._room_rad((coxa, femur, tibia), foot)
            if room_rad <= 0 or min(foot[0], -foot[1]) < least_m:
                continue
            off = math.hypot(femur_rad - TARGET_SLOPES_RAD[0], tibia_rad - TARGET_SLOPES_RAD[1])
            places.append((off + max(0.0, TARGET_ROOM_RAD - room_rad) * 4, foot))
        own = self._own_stance((coxa, femur, tibia))
        feet = [own] if own is not None else []
        feet += [foot for _, foot in sorted(places)]
        return tuple((outward, up + self._mount_up_m) for outward, up in feet)

    def _vectors(self) -> tuple[Vector2, Vector2, Vector2]:
        coxa, femur, tibia = ((float(one[0]), float(one[1])) for one in self._parts.vectors_m)
        return coxa, femur, tibia

    def _own_stance(self, links: tuple[Vector2, Vector2, Vector2]) -> Vector2 | None:
        """Place of the feet in the file's own stance, from the coxa joint, if all legs have the same."""
        feet = []
        slopes = [math.atan2(link[1], link[0]) for link in links]
        for leg in self._legs:
            angles = [self._tree.stance_rad.get(joint.name, math.nan) for joint in leg.joints]
            _, femur, tibia = leg.signs * np.array(angles) + leg.zeros_rad
            feet.append(_place(links, slopes[1] + femur, slopes[2] + femur + tibia))
        if not np.isfinite(feet).all() or np.ptp(feet, axis=0).max() > 0.005:
            return None
        outward, up = np.mean(feet, axis=0).tolist()
        fits = min(outward, -up) > LEAST_FOOT * self._parts.leg_m and self._room_rad(links, (outward, up)) > 0
        return (outward, up) if fits else None

    def _room_rad(self, links: tuple[Vector2, Vector2, Vector2], foot: Vector2) -> float:
        """Distance of the nearest limit from the angles that put the foot there, negative beyond it."""
        try:
            angles_rad = stance_angles(*links, foot)
        except (InputError, ValueError):  # out of reach, or stretched to the last digit
            return -math.inf
        room_deg = [
            min(
                math.degrees(angle) - self._joints[kind]["min_deg"],
                self._joints[kind]["max_deg"] - math.degrees(angle),
            )
            for kind, angle in zip(("femur", "tibia"), angles_rad, strict=True)
        ]
        return math.radians(min(room_deg))

    def why_no_stance(self) -> str:
        """Ranges of femur and tibia, and the reach of the leg."""
        ranges = ", ".join(
            f"{kind} {self._joints[kind]['min_deg']:.0f} to {self._joints[kind]['max_deg']:.0f} deg"
            for kind in ("femur", "tibia")
        )
        _, femur, tibia = self._vectors()
        least_m, most_m = leg_reach_m(femur, tibia)
        return (
            f"got {ranges}; feet {least_m:.4g} to {most_m:.4g} m from the femur joints; see to these ranges "
            "and to --foot"
        )


def _place(links: Sequence[Vector2], femur_rad: float, tibia_rad: float) -> Vector2:
    """Foot from the coxa joint, (outward, up), by the slopes of femur and tibia."""
    coxa, femur, tibia = links[0], math.hypot(*links[1]), math.hypot(*links[2])
    outward = coxa[0] + femur * math.cos(femur_rad) + tibia * math.cos(tibia_rad)
    return outward, coxa[1] + femur * math.sin(femur_rad) + tibia * math.sin(tibia_rad)


def _zero_text(zero_rad: float) -> str:
    return f" {math.degrees(zero_rad):+.2f} deg" if abs(zero_rad) > 1e-6 else ""


def _short_name(text: str) -> str:
    name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:40]
    return name or "robot"
