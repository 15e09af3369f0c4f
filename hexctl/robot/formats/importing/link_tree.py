"""A robot description of another tool as a tree of links and joints, whatever its file format."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hexctl.robot.rotations import transformed_points
from hexctl.types import FloatArray

HINGES = ("revolute", "continuous")

#: Kinds of joints that carry nothing: the other link moves freely.
LOOSE = ("floating", "planar")

#: A link with less than this share of the mass needs no moments of inertia.
LIGHT_SHARE = 0.05

#: Limits of a description: the time to place links grows with the square of their number.
MOST_BYTES, MOST_LINKS = 5_000_000, 500

#: A hinge that turns less than this stands for a rigid joint: touch sensors and springs are written so.
RIGID_RANGE_RAD = 0.05


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid of a link.

    Attributes:
        kind: `box`, `cylinder`, `capsule`, `sphere` or `mesh`.
        size_m: length, width and height, or radius and length (of a capsule without its ends).
        frame: in the frame of the link, (4, 4).
        points_m: of a mesh, in its own frame, (N, 3).
    """

    kind: str
    size_m: tuple[float, ...]
    frame: FloatArray
    points_m: FloatArray | None = None

    @property
    def ends(self) -> FloatArray:
        """Points at its ends in the frame of the link, (N, 3) in m: on the axis, if it has one."""
        if self.points_m is not None:
            points = self.points_m
        elif self.kind == "sphere":
            points = np.zeros((1, 3))
        elif self.kind == "box":
            axis = int(np.argmax(self.size_m))
            points = np.array([np.eye(3)[axis] * end * self.size_m[axis] / 2 for end in (-1, 1)])
        else:
            points = np.array([[0, 0, end * self.size_m[1] / 2] for end in (-1, 1)])
        return transformed_points(points, self.frame)

    def bounds(self, frame: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest coordinates, (3,) each in m, if the frame of the link is (4, 4)."""
        placed = frame @ self.frame
        turn, centre = placed[:3, :3], placed[:3, 3]
        if self.points_m is not None:
            points = transformed_points(self.points_m, placed)
            return points.min(axis=0), points.max(axis=0)
        half = self._half(turn)
        return centre - half, centre + half

    def _half(self, turn: FloatArray) -> FloatArray:
        """Half the extent along each axis, after a turn (3, 3)."""
        if self.kind == "box":
            return np.asarray(np.abs(turn) @ np.array(self.size_m) / 2)
        radius_m = self.size_m[0]
        if self.kind == "sphere":
            return np.full(3, radius_m)
        along = np.abs(turn[:, 2])
        across = np.sqrt(np.maximum(0.0, 1 - along**2)) if self.kind == "cylinder" else np.ones(3)
        return np.asarray(along * self.size_m[1] / 2 + across * radius_m)


@dataclass(frozen=True, eq=False)
class TreeLink:
    """A link.

    Attributes:
        mass_kg: None if missing.
        com_m: centre of mass in the frame of the link.
        inertia_kg_m2: about the centre of mass, along the axes of the link, (3, 3), or None if missing.
        unread_meshes: files, each with the reason.
        unweighed: those of them whose masses are not known, because the file gives none.
    """

    name: str
    mass_kg: float | None = None
    com_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    inertia_kg_m2: FloatArray | None = None
    solids: tuple[Solid, ...] = ()
    unread_meshes: tuple[str, ...] = ()
    unweighed: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class JoinedMass:
    """Links fixed to one another, as one body, along the axes of a common frame.

    The tensor is about the centre of mass, which is the origin if nothing has a mass. Heavy links without
    moments of inertia, `bare`, count as points. Meshes of an unknown mass, `unweighed`, do not count.
    """

    mass_kg: float
    com_m: FloatArray
    inertia_kg_m2: FloatArray
    bare: tuple[str, ...]
    unweighed: tuple[str, ...] = ()

    @property
    def missing(self) -> str:
        """Why the mass is not complete, or an empty text."""
        return f"it lacks that of {', '.join(self.unweighed)}" if self.unweighed else ""


def joined_mass(links: Sequence[TreeLink], frames: Sequence[FloatArray]) -> JoinedMass:
    """Mass of links with their frames, (4, 4), in a common one."""
    masses_kg = [link.mass_kg or 0.0 for link in links]
    mass_kg, tensor = sum(masses_kg), np.zeros((3, 3))
    coms_m = [(frame @ [*link.com_m, 1.0])[:3] for frame, link in zip(frames, links, strict=True)]
    com_m = np.average(coms_m, axis=0, weights=masses_kg) if mass_kg > 0 else np.zeros(3)
    for link, frame, kg, at_m in zip(links, frames, masses_kg, coms_m - com_m, strict=True):
        if link.inertia_kg_m2 is not None:
            tensor += frame[:3, :3] @ link.inertia_kg_m2 @ frame[:3, :3].T
        tensor += kg * (at_m @ at_m * np.eye(3) - np.outer(at_m, at_m))
    bare = [
        link.name
        for link, kg in zip(links, masses_kg, strict=True)
        if kg > LIGHT_SHARE * mass_kg and link.inertia_kg_m2 is None
    ]
    unweighed = dict.fromkeys(mesh for link in links for mesh in link.unweighed)
    return JoinedMass(mass_kg, com_m, tensor, tuple(bare), tuple(unweighed))


@dataclass(frozen=True, eq=False)
class TreeJoint:
    """A joint; None for missing values.

    Attributes:
        frame: in the frame of the parent at angle zero, (4, 4).
        axis: unit vector in the frame of the joint, (3,).
        damping_nm_s_per_rad: torque lost per speed.
        stiffness_nm_per_rad: of the position control that drives it.
        control_nm_s_per_rad: damping of that control.
        dead_time_s: from a command to its effect.
        follows: joint whose angle it copies.
    """

    name: str
    kind: str
    parent: str
    child: str
    frame: FloatArray
    axis: FloatArray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    limits_rad: tuple[float, float] | None = None
    torque_nm: float | None = None
    speed_rad_s: float | None = None
    friction_nm: float | None = None
    damping_nm_s_per_rad: float | None = None
    stiffness_nm_per_rad: float | None = None
    control_nm_s_per_rad: float | None = None
    rotor_inertia_kg_m2: float | None = None
    dead_time_s: float | None = None
    follows: str | None = None

    @property
    def hinge(self) -> bool:
        """Whether it turns; limits of 0 and 0 are a placeholder, not a rigid joint."""
        if self.kind not in HINGES:
            return False
        limits = self.limits_rad if self.kind == "revolute" else None
        return limits is None or not 0 < abs(limits[1] - limits[0]) < RIGID_RANGE_RAD

    @property
    def loose(self) -> bool:
        """Whether it carries nothing."""
        return self.kind in LOOSE


@dataclass(frozen=True, eq=False)
class LinkTree:
    """Links and joints of a robot by name, joints by that of their child, with a single root.

    Attributes:
        stance_rad: angles of hinges, by name, in which the file lets it stand.
        left_out_kg: masses in the file that are no part of the robot, by name.
        numbers: further values by name, those that `hexctl.robot.formats.mjcf` writes.
    """

    name: str
    root: str
    links: dict[str, TreeLink]
    joints: dict[str, TreeJoint]
    children: dict[str, list[str]] = field(default_factory=dict)
    stance_rad: dict[str, float] = field(default_factory=dict)
    left_out_kg: dict[str, float] = field(default_factory=dict)
    numbers: dict[str, tuple[float, ...]] = field(default_factory=dict)

    def frame_in_root(self, link: str) -> FloatArray:
        """Frame of a link in that of the root with all joints at zero, (4, 4)."""
        frame = np.eye(4)
        while link != self.root:
            frame = self.joints[link].frame @ frame
            link = self.joints[link].parent
        return frame

    def axis_in_root(self, joint: TreeJoint) -> FloatArray:
        """Axis of a joint in the frame of the root with all joints at zero, (3,)."""
        return np.asarray(self.frame_in_root(joint.child)[:3, :3] @ joint.axis)

    def hinges(self, link: str) -> tuple[TreeJoint, ...]:
        """Hinges between the root and a link, from the root outward."""
        found = []
        while link != self.root:
            joint = self.joints[link]
            found += [joint] if joint.hinge else []
            link = joint.parent
        return tuple(reversed(found))

    def rigid(self, link: str) -> list[str]:
        """A link and all links fixed to it."""
        return self.carried(link, *(one.child for one in self.joints.values() if one.hinge or one.loose))

    def carried(self, link: str, *without: str) -> list[str]:
        """A link and all links beyond it, but for the branches that begin at others."""
        found, waiting, left_out = [], [link], frozenset(without)
        while waiting:
            found.append(waiting.pop())
            waiting += [one for one in reversed(self.children.get(found[-1], ())) if one not in left_out]
        return found

    def unread_meshes(self, links: list[str]) -> tuple[str, ...]:
        """Unread meshes of links."""
        return tuple(dict.fromkeys(text for name in links for text in self.links[name].unread_meshes))


def tree_of(
    name: str,
    links: list[TreeLink],
    joints: list[TreeJoint],
    **more: dict[str, float] | dict[str, tuple[float, ...]],
) -> LinkTree:
    """A tree of links and joints.

    Raises ValueError for names that are not unique, a joint of an unknown link, a link that two joints
    carry, two roots, or a loop.
    """
    by_name, by_child = {link.name: link for link in links}, {joint.child: joint for joint in joints}
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in by_name:
                raise ValueError(f"joint {joint.name} names the link {end!r}, which is not there")
    if len(by_name) < len(links):
        counts = Counter(link.name for link in links)
        twice, count = counts.most_common(1)[0]
        raise ValueError(f"got {count} links named {twice!r}; allowed: a name each")
    if len(by_child) < len(joints):
        child, count = Counter(joint.child for joint in joints).most_common(1)[0]
        names = ", ".join(joint.name for joint in joints if joint.child == child)
        raise ValueError(f"got {count} joints that carry the link {child!r} ({names}); allowed: one")
    roots = [link for link in by_name if link not in by_child]
    if len(roots) != 1:
        names = ", ".join(roots[:5]) or "none"
        raise ValueError(f"got {len(roots)} links that nothing carries ({names}); allowed: one")
    children: dict[str, list[str]] = {}
    for joint in by_child.values():
        children.setdefault(joint.parent, []).append(joint.child)
    tree = LinkTree(name, roots[0], by_name, by_child, children, **more)  # type: ignore[arg-type]
    if _count(tree) != len(by_name):
        raise ValueError("its joints make a loop; allowed: a tree")
    return tree


def _count(tree: LinkTree) -> int:
    waiting, count = [tree.root], 0
    while waiting:
        waiting += tree.children.get(waiting.pop(), [])
        count += 1
    return count
