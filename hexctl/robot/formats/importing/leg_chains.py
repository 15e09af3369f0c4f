"""Find the chains of hinges that form the legs of a robot description; extra hinges are fixed."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np

from hexctl.errors import InputError
from hexctl.robot.formats.importing.link_tree import LinkTree, TreeJoint
from hexctl.robot.rotations import frame_of, quaternion_about, transformed_points
from hexctl.types import JOINTS_PER_LEG, N_LEGS, FloatArray

#: Tolerance of axes: files write 1.5707, and mounts lean a little.
AXIS_TOLERANCE_RAD = math.radians(3.0)
#: Distance below which two points of a foot are one.
FOOT_TOLERANCE_M = 0.01
#: Tolerance of differences between legs, as a share of the leg.
LEG_TOLERANCE = 0.025
#: Most hinges of a leg: the choice of three grows with the cube of their number.
MOST_HINGES = 12

Chain = tuple[TreeJoint, ...]


def fixed_text(fixed_rad: Mapping[str, float]) -> str:
    """Names of fixed hinges with their angles."""
    names: dict[str, list[str]] = {}
    for name, angle_rad in fixed_rad.items():
        names.setdefault(f"{math.degrees(angle_rad):.4g} deg", []).append(name)
    return "; ".join(f"{', '.join(of_angle)} at {angle}" for angle, of_angle in names.items())


def with_three_hinges(tree: LinkTree) -> tuple[LinkTree, dict[str, float]]:
    """The robot with three hinges per leg, and the angles of the hinges fixed for that, by name.

    Of the hinges of a leg without which it is a leg, the one that moves the foot least is fixed: in the
    stance of the file, else at zero, or in the middle of a range without zero.

    Raises InputError for legs of more hinges of which no three are those of a leg.
    """
    fixed_rad: dict[str, float] = {}
    while len(_three_hinges(tree)) != N_LEGS and (long := _long_chains(tree)):
        _check_independent(long)
        index = _least_index(tree, long)
        fixed = [chain[index] for chain in long]
        fixed_rad |= {joint.name: _angle_rad(tree, joint) for joint in fixed}
        joints = {joint.child: _fixed(joint, fixed_rad[joint.name]) for joint in fixed}
        tree = replace(tree, joints=tree.joints | joints)
    return tree, fixed_rad


def _long_chains(tree: LinkTree) -> list[Chain]:
    """Six chains of the same number of hinges, more than three, or none."""
    chains = _chains(tree)
    for count in range(JOINTS_PER_LEG + 1, MOST_HINGES + 1):
        long = _six_alike(tree, [chain for chain in chains if len(chain) == count])
        if len(long) == N_LEGS:
            return long
    return []


def _six_alike(tree: LinkTree, chains: list[Chain]) -> list[Chain]:
    """The six chains of equal lengths among more: others are arms; all chains if there are no such six."""
    lengths_m = np.array([_lengths_m(tree, chain) for chain in chains])
    for columns in (slice(-1), slice(None)) if len(chains) > N_LEGS else ():
        for one in lengths_m[:, columns]:
            off_m = np.abs(lengths_m[:, columns] - one).max(axis=1)
            alike = [
                chain for chain, off in zip(chains, off_m, strict=True) if off <= LEG_TOLERANCE * one.sum()
            ]
            if len(alike) == N_LEGS:
                return alike
    return chains


def _lengths_m(tree: LinkTree, chain: Chain) -> list[float]:
    """Distances between successive hinges of a chain, and from the last one to its end."""
    places = [tree.frame_in_root(joint.child)[:3, 3] for joint in chain]
    return [
        *(float(np.linalg.norm(end - start)) for start, end in pairwise(places)),
        _lever_m(tree, chain[-1], chain[-1]),
    ]


def _least_index(tree: LinkTree, chains: Sequence[Chain]) -> int:
    """Place in the chains of the hinge to hold; raises InputError without one."""
    chain = chains[0]
    lengths_m = {}
    for index in range(len(chain)):
        left = [each[:index] + each[index + 1 :] for each in chains]
        if all(_can_be_a_leg(tree, each) for each in left):
            lengths_m[index] = sum(_lever_m(tree, each[index], each[-1]) for each in chains)
    if not lengths_m:
        names = ", ".join(f"{joint.name} about {_axis_text(tree.axis_in_root(joint))}" for joint in chain)
        raise InputError(
            f"robot description: got legs of {len(chain)} hinges ({names}); allowed: legs of "
            f"{JOINTS_PER_LEG}, one vertical and two level and parallel; make the other hinges `fixed` in "
            "the description, at the angles at which they are held"
        )
    # Of hinges that move the foot as little, the outermost.
    return min(reversed(lengths_m), key=lambda index: round(lengths_m[index], 6))


def _can_be_a_leg(tree: LinkTree, chain: Chain) -> bool:
    """Whether three of the hinges, in this order, are those of a leg."""
    return any(_turns_as_a_leg(tree, three) for three in combinations(chain, JOINTS_PER_LEG))


def _lever_m(tree: LinkTree, joint: TreeJoint, last: TreeJoint) -> float:
    """Distance from the axis of a hinge of what lies farthest along its leg."""
    at = np.asarray(np.linalg.inv(tree.frame_in_root(joint.child)), dtype=float)
    tips_m = np.vstack([_points(tree, at, name) for name in tree.carried(last.child)])
    return float(np.linalg.norm(np.cross(tips_m, joint.axis), axis=-1).max())


def _angle_rad(tree: LinkTree, joint: TreeJoint) -> float:
    low, high = joint.limits_rad or (-math.pi, math.pi)
    own = tree.stance_rad.get(joint.name, 0.0)
    return own if low <= own <= high else (low + high) / 2


def _fixed(joint: TreeJoint, angle_rad: float) -> TreeJoint:
    turn = frame_of(np.zeros(3), quaternion_about(joint.axis, angle_rad))
    return replace(joint, kind="fixed", frame=joint.frame @ turn)


def axis_problem(chain: Chain, axes: Sequence[FloatArray], up: FloatArray) -> str:
    """Why hinges are not a vertical one, then two level and parallel ones, as in a leg; else an empty text.

    Axes are unit vectors, (3,), in a frame in which `up`, (3,), is the vertical.
    """
    off = math.sin(AXIS_TOLERANCE_RAD)
    if np.linalg.norm(np.cross(axes[0], up)) > off:
        return (
            f"the first hinge of a leg, {chain[0].name}, turns about {_axis_text(axes[0])} of the body; "
            "allowed: the vertical, the same for all six legs"
        )
    for joint, axis in zip(chain[1:], axes[1:], strict=True):
        if abs(axis @ up) > off:
            return f"the hinge {joint.name} turns about {_axis_text(axis)}; allowed: a level axis"
    if np.linalg.norm(np.cross(axes[1], axes[2])) > off:
        return (
            f"the hinges {chain[1].name} and {chain[2].name} turn about {_axis_text(axes[1])} and "
            f"{_axis_text(axes[2])}; allowed: parallel axes"
        )
    return ""


def _axis_text(axis: FloatArray) -> str:
    return f"({', '.join(f'{part:.2f}' for part in axis + 0.0)})"


def leg_chains(tree: LinkTree) -> list[Chain]:
    """The six chains of three hinges from the trunk; raises InputError if there are others or none."""
    chains, legs = _chains(tree), _three_hinges(tree)
    longer = next((chain for chain in chains if len(chain) > JOINTS_PER_LEG), None)
    if longer is not None and len(legs) != N_LEGS:
        count = sum(len(chain) == len(longer) for chain in chains)
        raise InputError(
            f"robot description: got {count} chains of {len(longer)} hinges, such as that from "
            f"{longer[0].name} to {longer[-1].name}; allowed: {N_LEGS} legs of {JOINTS_PER_LEG}; make the "
            "other hinges `fixed` in the description"
        )
    if len(legs) != N_LEGS:
        names = ", ".join(f"{chain[0].name} to {chain[-1].name}" for chain in legs[: 2 * N_LEGS])
        raise InputError(
            f"robot description: got {len(legs)} chains of {JOINTS_PER_LEG} hinges ({names or 'none'}); "
            f"allowed: {N_LEGS} legs; make the hinges of arms and heads `fixed` in the description"
        )
    if len({chain[0].name for chain in legs}) != N_LEGS:
        raise InputError(
            f"robot description: got legs that share the hinge {legs[0][0].name}; allowed: separate legs"
        )
    _check_independent(legs)
    return legs


def _check_independent(chains: Sequence[Chain]) -> None:
    joint = next((joint for chain in chains for joint in chain if joint.follows), None)
    if joint is not None:
        raise InputError(
            f"robot description: the hinge {joint.name} of a leg follows {joint.follows} (`mimic`); allowed: "
            "hinges with a servo each; make it `fixed` if it hardly moves the foot"
        )


def _three_hinges(tree: LinkTree) -> list[Chain]:
    """Chains of three hinges; of more than six, those that turn as legs do, and of these the six alike."""
    legs = [chain for chain in _chains(tree) if len(chain) == JOINTS_PER_LEG]
    if len(legs) > N_LEGS:
        legs = _six_alike(tree, [chain for chain in legs if _turns_as_a_leg(tree, chain)])
    return legs


def _chains(tree: LinkTree) -> list[Chain]:
    """Chains of hinges from the trunk outward, the longest of each branch."""
    found: dict[tuple[str, ...], Chain] = {}
    for link in tree.links:
        if link not in tree.children:
            chain = _without_idle_ends(tree, tree.hinges(link))
            found[tuple(joint.name for joint in chain)] = chain
    return [
        chain
        for names, chain in found.items()
        if not any(other[: len(names)] == names for other in found if other != names)
    ]


def _without_idle_ends(tree: LinkTree, chain: tuple[TreeJoint, ...]) -> tuple[TreeJoint, ...]:
    """A chain without hinges at its end that move no foot: nothing beyond them is off their axis."""
    while len(chain) > JOINTS_PER_LEG and _lever_m(tree, chain[-1], chain[-1]) < FOOT_TOLERANCE_M:
        chain = chain[:-1]
    return chain


def _points(tree: LinkTree, at: FloatArray, link: str) -> FloatArray:
    """Origin of a link and ends of its solids in another frame, (N, 3) in m."""
    frame = at @ tree.frame_in_root(link)
    solids = tree.links[link].solids
    return np.vstack([frame[:3, 3], *(transformed_points(solid.ends, frame) for solid in solids)])


def _turns_as_a_leg(tree: LinkTree, chain: Chain) -> bool:
    axes = [tree.axis_in_root(joint) for joint in chain]
    return not axis_problem(chain, axes, up=axes[0])
