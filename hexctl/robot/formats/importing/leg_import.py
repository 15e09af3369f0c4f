"""The links and joints of the legs of a robot description, as sections of a robot file."""

import math
from typing import Any

import numpy as np

from hexctl.errors import InputError
from hexctl.robot.formats.importing.import_values import (
    NM_PER_KG_M,
    RANGES_DEG,
    SPEEDS_DEG_S,
    USUAL_FOOT_M,
    USUAL_LEG_M,
    USUAL_RADIUS_M,
    USUAL_RANGE_DEG,
    USUAL_SPEED_DEG_S,
    USUAL_TORQUE_NM,
    Findings,
    UsualMasses,
    least_mass_kg,
    possible_tensor,
    rounded,
)
from hexctl.robot.formats.importing.link_tree import LinkTree, TreeJoint, joined_mass
from hexctl.robot.formats.importing.tree_legs import TreeLeg
from hexctl.robot.formats.mjcf import GEAR_KEY, LOAD_KEY, PLAY_KEY, SPEED_KEY
from hexctl.robot.plausibility import LINK_INERTIAS, MOST_RANGE_DEG, TORQUES_NM, too_dense
from hexctl.robot.rotations import about_z, matrix_of, quaternion_about
from hexctl.types import JOINT_KINDS, FloatArray

#: A servo follows its target within this: it turns by 60 degrees in 0.1 to 0.25 s.
MOST_LAG_S = 0.2

#: Error of a joint at full torque, about 5 degrees, as common digital servos are set.
USUAL_ERROR_RAD = 0.085

_NOT_DESCRIBED = "descriptions do not have it"

_UNITS = "; in deg that is {:.4g} to {:.4g} deg: descriptions count in radians"

#: A foot sphere is at most this large.
MOST_FOOT_M = 0.03


class LegImport:
    """Sections of the legs; values of the six legs are their mean, or what all of them allow."""

    def __init__(self, tree: LinkTree, legs: list[TreeLeg], facing: FloatArray, findings: Findings) -> None:
        self._tree, self._legs, self._facing, self._findings = tree, legs, facing, findings
        #: Coxa, femur and tibia at angle zero, (3, 2) as (outward, up).
        self.vectors_m = np.mean([leg.vectors_m for leg in legs], axis=0)
        lengths_m = np.linalg.norm(self.vectors_m, axis=-1)
        self.leg_m, self._moving_m = float(lengths_m.sum()), float(lengths_m[1:].sum())
        torques_nm = [leg.joints[1].torque_nm for leg in legs]
        self.usual_masses = UsualMasses.of(self.leg_m, self._moving_m, torques_nm)
        self.least_mass_kg = least_mass_kg(self.leg_m)
        self._usual_torque_nm = self._weight_torque_nm()

    def links(self) -> dict[str, dict[str, Any]]:
        """The section `links`, without moments of inertia."""
        guess = next((leg.foot_guess for leg in self._legs if leg.foot_guess), "")
        if guess:
            self._findings.reasons["links.tibia.end_m"] = guess
        return {kind: self._link(index) for index, kind in enumerate(JOINT_KINDS)}

    def dense_parts(self) -> dict[str, tuple[float, tuple[float, float, float]]]:
        """Mean mass in the file, and length without width and height, of coxa, femur and tibia."""
        lengths_m = np.linalg.norm(self.vectors_m, axis=-1)
        return {
            kind: (float(self._masses(index)[0].mean()), (float(lengths_m[index]), 0.0, 0.0))
            for index, kind in enumerate(JOINT_KINDS)
        }

    def joints(self) -> dict[str, dict[str, Any]]:
        """The section `joints`."""
        joints = {kind: self._joint(index) for index, kind in enumerate(JOINT_KINDS)}
        self._add_no_load_speeds(joints)
        return joints

    def _weight_torque_nm(self) -> float:
        """Assumed torque limit: the usual one, or what a heavy robot needs."""
        mass_kg = sum(link.mass_kg or 0.0 for link in self._tree.links.values())
        return float(np.clip(NM_PER_KG_M * mass_kg * self._moving_m, USUAL_TORQUE_NM, TORQUES_NM[1]))

    def _link(self, index: int) -> dict[str, Any]:
        kind, end_m = JOINT_KINDS[index], self.vectors_m[index]
        length_m = float(np.linalg.norm(end_m))
        masses_kg, coms_m, _, missing = self._masses(index)
        mass_kg, key = float(masses_kg.mean()), f"links.{kind}.mass_kg"
        if masses_kg.min() < self.least_mass_kg:
            mass_kg = self.usual_masses.parts_kg[kind]
            self._findings.reasons[key] = self.usual_masses.reason(masses_kg.min(), kind)
        elif too_dense(masses_kg.max(), (length_m, 0.0, 0.0)):
            self._findings.reasons[key] = f"got {masses_kg.max():g} kg, denser than links are; it is kept"
        elif missing:
            self._findings.reasons[key] = f"{missing}; {mass_kg:g} kg of the rest were taken"
        link: dict[str, Any] = {"end_m": [rounded(part) for part in end_m], "mass_kg": rounded(mass_kg)}
        link["radius_m"] = self._radius_m(index, length_m)
        com_m = coms_m.mean(axis=0)[[0, 2]]
        # A centre of mass in the joint is a placeholder.
        if key not in self._findings.reasons and 1e-4 < np.linalg.norm(com_m) < 1.5 * length_m:
            link["com_m"] = [rounded(part) for part in com_m]
        return link

    def _masses(self, index: int) -> tuple[FloatArray, FloatArray, FloatArray, str]:
        """Mass, centre of mass from the joint, and tensor about it, of a link and everything that it carries.

        Shapes (6,), (6, 3) and (6, 3, 3), the latter two along outward, left and up of each leg at angle
        zero; a tensor is NaN if a heavy part has none. Last, why the masses are not complete.
        """
        tree, found, missing = self._tree, [], ""
        for leg in self._legs:
            links = [tree.links[name] for name in self._parts(leg, index)]
            axes = self._leg_frame(leg, leg.joints[index])
            joined = joined_mass(links, [axes @ tree.frame_in_root(link.name) for link in links])
            missing = missing or joined.missing
            turn = self._plane_turn(leg, index)
            tensor = np.full((3, 3), np.nan) if joined.bare else joined.inertia_kg_m2
            found.append((joined.mass_kg, turn @ joined.com_m, turn @ tensor @ turn.T))
        masses, coms, tensors = (np.array(part) for part in zip(*found, strict=True))
        return masses, coms, tensors, missing

    def _parts(self, leg: TreeLeg, index: int) -> list[str]:
        """Links of a part: what its hinge carries, but for what the next one does."""
        return self._tree.carried(*(joint.child for joint in leg.joints[index : index + 2]))

    def _leg_frame(self, leg: TreeLeg, joint: TreeJoint) -> FloatArray:
        """Transform from the root to outward, left and up of a leg, from a joint, (4, 4)."""
        frame = np.eye(4)
        frame[:3, :3] = matrix_of(about_z(-leg.yaw_rad - float(leg.zeros_rad[0]))) @ self._facing[:3, :3]
        frame[:3, 3] = -frame[:3, :3] @ self._tree.frame_in_root(joint.child)[:3, 3]
        return frame

    def _plane_turn(self, leg: TreeLeg, index: int) -> FloatArray:
        """Turn (3, 3) of a link in the plane of its leg from its own zero to that of the first leg."""
        angle_rad = float(leg.zeros_rad[1 : index + 1].sum())
        return matrix_of(quaternion_about((0.0, 1.0, 0.0), angle_rad))

    def inertia(self, index: int, even: tuple[float, ...]) -> list[float] | None:
        """Moments and product (outward, left, up, outward-up) of a link, or None for those of its capsule."""
        key, mass_key = (f"links.{JOINT_KINDS[index]}.{name}" for name in ("inertia_kg_m2", "mass_kg"))
        _, _, tensors, _ = self._masses(index)
        if mass_key in self._findings.reasons:
            return None
        tensor = tensors.mean(axis=0)
        if not np.isfinite(tensor).all():
            self._findings.reasons[key] = "it is missing; that of an evenly filled capsule was assumed"
            return None
        if np.allclose(_moments(tensor), even, rtol=1e-5, atol=1e-6 * sum(even[:3])):
            return None
        tensor[[0, 1, 1, 2], [1, 0, 2, 1]] = 0.0
        tensor, problem = possible_tensor(tensor, even[:3], LINK_INERTIAS)
        if problem:
            self._findings.reasons[key] = f"{problem}; that of an evenly filled capsule was assumed"
            return None
        return [rounded(moment) for moment in _moments(tensor)]

    def _radius_m(self, index: int, length_m: float) -> float:
        """Radius of the cylinder or capsule whose length is most like the link's."""
        leg = self._legs[0]
        solids = [solid for name in self._parts(leg, index) for solid in self._tree.links[name].solids]
        round_ones = [solid for solid in solids if solid.kind in ("cylinder", "capsule")]
        if not round_ones:
            self._findings.reasons[f"links.{JOINT_KINDS[index]}.radius_m"] = "no cylinder shows it"
            return rounded(min(self._usual_m(USUAL_RADIUS_M), 0.45 * length_m))
        best = min(round_ones, key=lambda solid: abs(solid.size_m[1] - length_m))
        return rounded(min(best.size_m[0], 0.45 * length_m))

    def _usual_m(self, length_m: float) -> float:
        """A length of a usual robot, in proportion; larger robots have the same."""
        return length_m * min(1.0, self.leg_m / USUAL_LEG_M)

    def foot_radius_m(self) -> float:
        """Radius of the sphere at the foot, the smallest of the legs."""
        radii_m = [self._sphere_m(leg) for leg in self._legs]
        known = [radius for radius in radii_m if radius is not None]
        if len(known) < len(radii_m):
            self._findings.reasons["foot_radius_m"] = "no sphere at the foot shows it"
        return rounded(min(known, default=self._usual_m(USUAL_FOOT_M)))

    def _sphere_m(self, leg: TreeLeg) -> float | None:
        found = []
        for name in leg.tips:
            frame = self._facing @ self._tree.frame_in_root(name)
            for solid in self._tree.links[name].solids:
                centre_m = (frame @ solid.frame)[:3, 3]
                away_m = float(np.linalg.norm(centre_m - leg.foot_m))
                if solid.kind == "sphere" and away_m < solid.size_m[0] <= MOST_FOOT_M:
                    found.append((away_m, solid.size_m[0]))
        return min(found)[1] if found else None

    def _joint(self, index: int) -> dict[str, Any]:
        kind = JOINT_KINDS[index]
        joints = [leg.joints[index] for leg in self._legs]
        low_deg, high_deg = self._range_deg(index)
        torque_nm = self._findings.plausible(
            f"joints.{kind}.max_torque_nm",
            [one.torque_nm for one in joints],
            TORQUES_NM,
            "N m",
            self._usual_torque_nm,
            ", for its weight," if self._usual_torque_nm > USUAL_TORQUE_NM else "",
        )
        section: dict[str, Any] = {
            "min_deg": low_deg,
            "max_deg": high_deg,
            "max_speed_deg_s": self._speed_deg_s(index),
            "max_torque_nm": rounded(torque_nm),
        }
        friction_nm = max(one.friction_nm or 0.0 for one in joints)
        if friction_nm >= torque_nm:
            reason = f"got {friction_nm:g} N m, above the torque; 0 was assumed"
            self._findings.reasons[f"joints.{kind}.dry_friction_nm"] = reason
        elif friction_nm > 0:
            section["dry_friction_nm"] = rounded(friction_nm)
        return section

    def _speed_deg_s(self, index: int) -> float:
        known = self._tree.numbers.get(SPEED_KEY, ())
        if len(known) == len(JOINT_KINDS):
            return rounded(math.degrees(known[index]))
        speeds_rad_s = [leg.joints[index].speed_rad_s for leg in self._legs]
        speeds_deg_s = [None if speed is None else math.degrees(speed) for speed in speeds_rad_s]
        key = f"joints.{JOINT_KINDS[index]}.max_speed_deg_s"
        return rounded(self._findings.plausible(key, speeds_deg_s, SPEEDS_DEG_S, "deg/s", USUAL_SPEED_DEG_S))

    def _add_no_load_speeds(self, joints: dict[str, dict[str, Any]]) -> None:
        """Add the speeds at which damping takes all torque; all kinds have one, or none has."""
        found = {}
        for index, (kind, section) in enumerate(joints.items()):
            damping = max(leg.joints[index].damping_nm_s_per_rad or 0.0 for leg in self._legs)
            speed_rad_s = section["max_torque_nm"] / damping if damping > 0 else math.inf
            if math.degrees(speed_rad_s) > SPEEDS_DEG_S[1]:
                continue
            if math.degrees(speed_rad_s) < section["max_speed_deg_s"] * (1 - 1e-6):
                reason = f"got a damping of {damping:g} N m s/rad, too much for its speed; none was assumed"
                self._findings.reasons[f"joints.{kind}.no_load_speed_deg_s"] = reason
                continue
            found[kind] = rounded(max(math.degrees(speed_rad_s), section["max_speed_deg_s"]))
        if len(found) == len(joints):
            for kind, speed_deg_s in found.items():
                joints[kind]["no_load_speed_deg_s"] = speed_deg_s
        elif found:
            self._findings.notes.append(
                f"the damping of {', '.join(found)} joints was left out: other joints have none"
            )

    def _range_deg(self, index: int) -> tuple[float, float]:
        kind, ranges = JOINT_KINDS[index], []
        for leg in self._legs:
            joint, sign, zero_deg = leg.joints[index], leg.signs[index], math.degrees(leg.zeros_rad[index])
            limits = joint.limits_rad if joint.kind == "revolute" else None
            if limits is not None and limits[0] != limits[1]:
                if limits[0] > limits[1]:
                    self._findings.notes.append(
                        f"the limits of {joint.name} were swapped: its lower one is above its upper one"
                    )
                ranges.append(sorted(math.degrees(sign * end) + zero_deg for end in limits))
        lows, highs = [low for low, _ in ranges], [high for _, high in ranges]
        low, high = max(lows, default=-180.0), min(highs, default=180.0)
        if ranges and max(np.ptp(lows), np.ptp(highs)) > 1:
            self._findings.notes.append(
                f"the {kind} joints have other ranges on other legs; what all allow was taken"
            )
        least_deg = RANGES_DEG[0]
        if ranges and high - low < least_deg < min(top - bottom for bottom, top in ranges):
            raise InputError(
                f"robot description: the {kind} joints allow {low:.0f} to {high:.0f} deg in common; allowed: "
                f"{least_deg:g} deg or more; correct the limits of the joint that differs"
            )
        if len(ranges) < len(self._legs) or not RANGES_DEG[0] <= high - low < RANGES_DEG[1]:
            reason = f"got {low:.4g} to {high:.4g} deg" if len(ranges) == len(self._legs) else "it is missing"
            if ranges and high - low > MOST_RANGE_DEG:
                reason += _UNITS.format(math.radians(low), math.radians(high))
            reason += f"; {-USUAL_RANGE_DEG:g} to {USUAL_RANGE_DEG:g} deg were assumed"
            self._findings.reasons.update({f"joints.{kind}.{end}": reason for end in ("min_deg", "max_deg")})
            return -USUAL_RANGE_DEG, USUAL_RANGE_DEG
        return rounded(max(low, -180.0)), rounded(min(high, 180.0))

    def servo(self, joints: dict[str, dict[str, Any]]) -> dict[str, float]:
        """The section `servo`; joint kinds with another stiffness than the tibiae, or play, get their own."""
        torque_nm, numbers = min(joint["max_torque_nm"] for joint in joints.values()), self._tree.numbers
        stiffness = self._stiffness(joints, torque_nm)
        damping, rotor_inertia = self._damping(stiffness), self._mean("rotor_inertia_kg_m2")
        if rotor_inertia is None:
            self._findings.reasons["servo.rotor_inertia_kg_m2"] = _NOT_DESCRIBED
            rotor_inertia = 0.002 * torque_nm / USUAL_TORQUE_NM
        servo = {
            "stiffness_nm_per_rad": stiffness,
            "damping_nm_s_per_rad": damping,
            "rotor_inertia_kg_m2": rotor_inertia,
            "dead_time_s": self._mean("dead_time_s"),
            "gear_damping_nm_s_per_rad": next(iter(numbers.get(GEAR_KEY, ())), None),
            "load_friction": next(iter(numbers.get(LOAD_KEY, ())), None),
        }
        for joint, play_rad in zip(joints.values(), numbers.get(PLAY_KEY, ()), strict=False):
            joint["play_deg"] = rounded(math.degrees(play_rad))
        return {name: rounded(value) for name, value in servo.items() if value is not None}

    def _mean(self, name: str, index: int = -1) -> float | None:
        """Mean of a value of the six joints of a kind, the tibiae unless given, if all are above 0."""
        values = [getattr(leg.joints[index], name) or 0.0 for leg in self._legs]
        return float(np.mean(values)) if min(values) > 0 else None

    def _stiffness(self, joints: dict[str, dict[str, Any]], torque_nm: float) -> float:
        """Stiffness of the tibiae; other kinds get theirs in their sections."""
        found = [self._mean("stiffness_nm_per_rad", index) for index in range(len(joints))]
        known = [value for value in found if value is not None]
        if len(known) < len(found):
            self._findings.reasons["servo.stiffness_nm_per_rad"] = _NOT_DESCRIBED
            return torque_nm / USUAL_ERROR_RAD
        for section, value in zip(joints.values(), known, strict=True):
            if abs(value / known[-1] - 1) > 1e-6:
                section["stiffness_nm_per_rad"] = rounded(value)
        return known[-1]

    def _damping(self, stiffness: float) -> float:
        known, reason = self._mean("control_nm_s_per_rad"), _NOT_DESCRIBED
        if known is not None and known <= MOST_LAG_S * stiffness:
            return known
        if known is not None:
            lag_s = known / stiffness
            reason = f"got {known:g}, with which a joint lags by {lag_s:.2g} s, as no servo does"
        self._findings.reasons["servo.damping_nm_s_per_rad"] = reason
        return 0.02 * stiffness


def _moments(tensor: FloatArray) -> list[float]:
    """Moments and product of a link from its tensor, (3, 3)."""
    return [*np.diag(tensor).tolist(), float(tensor[0, 2])]
