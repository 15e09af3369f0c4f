"""A third-party MJCF, compiled by MuJoCo, as a tree of links and joints."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from hexctl.mujoco_import import mujoco
from hexctl.robot.formats.importing.link_tree import (
    MOST_LINKS,
    LinkTree,
    Solid,
    TreeJoint,
    TreeLink,
    tree_of,
)
from hexctl.robot.formats.importing.mesh_files import MOST_BYTES_OF_ALL, find_mesh, stl_volume
from hexctl.robot.formats.mjcf import GEAR_KEY
from hexctl.robot.rotations import frame_of, matrix_of
from hexctl.robot.schema import USUAL_GEAR_DAMPING_NM_S_PER_RAD
from hexctl.types import N_JOINTS, FloatArray

#: Keyframes in which a robot stands; else the first one counts.
STANCES = ("stance", "stand", "home")

#: Mass of a body without any, and radius of a ball in place of an unread mesh.
NO_MASS_KG, NO_SIZE_M = 1e-9, 1e-4

#: Maximum size of all meshes, the smallest first: MuJoCo takes thirty times as much memory.
MOST_MESH_BYTES = 8_000_000


def compiled_tree(path: Path) -> LinkTree:
    """Tree of an MJCF file, compiled in this process without any limit.

    Raises OSError or ValueError for no valid MJCF.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        _name_bodies(spec.bodies)
        _without_surroundings(spec)
        unread = _with_found_meshes(spec, path)
        model = spec.compile()
    except (mujoco.FatalError, RuntimeError) as error:
        raise ValueError(str(error)) from error
    if model.nbody > MOST_LINKS:
        raise ValueError(f"got {model.nbody} bodies; allowed: a robot of up to {MOST_LINKS}")
    if spec.compiler.degree and _seem_radians(model):
        raise ValueError(
            "most hinges turn by less than 6.3 deg: if their ranges are radians, the file needs "
            '<compiler angle="radian"/>'
        )
    return _Reader(model, unread).tree(spec.modelname)


def _name_bodies(bodies: Sequence[Any]) -> None:
    """Give bodies without a name one that is free."""
    used = {body.name for body in bodies}
    free = (name for name in map("body{}".format, count()) if name not in used)
    for body in bodies:
        body.name = body.name or next(free)


def _without_surroundings(spec: Any) -> None:
    """Remove looks, height fields, sensors and contacts, and the hulls that only contacts need."""
    for one in (*spec.geoms, *spec.sites, *spec.tendons):
        one.material = ""
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    spec.compiler.discardvisual = False
    reliefs = [geom for geom in spec.geoms if geom.hfieldname]
    looks = (*spec.skins, *spec.materials, *spec.textures)
    for one in (*spec.sensors, *spec.pairs, *reliefs, *spec.hfields, *looks):
        spec.delete(one)


@dataclass(frozen=True, slots=True)
class _Unread:
    """Unread meshes by body: all, those whose masses are not known, and bodies with guessed inertia."""

    meshes: dict[str, list[str]] = field(default_factory=dict)
    unweighed: dict[str, list[str]] = field(default_factory=dict)
    uneven: set[str] = field(default_factory=set)


def _with_found_meshes(spec: Any, path: Path) -> _Unread:
    """Put balls of no size, with the masses in the file or by density, in place of unread meshes."""
    unread, bytes_of_all, volumes_m3 = _Unread(), 0, dict[str, float]()
    found = {one.name: (one, _mesh_file(spec, path, one.file)) for one in spec.meshes if one.file}
    missing = {name: mesh for name, (mesh, file) in found.items() if file is None}
    reasons = {name: f"{mesh.file} (not found)" for name, mesh in missing.items()}
    for mesh, file in sorted(found.values(), key=lambda one: one[1].stat().st_size if one[1] else 0):
        if file is None:
            continue
        bytes_of_all += file.stat().st_size
        if bytes_of_all > MOST_MESH_BYTES:
            reasons[mesh.name] = f"{mesh.file} (with it, meshes have more than {MOST_MESH_BYTES / 1e6:g} MB)"
            if bytes_of_all <= MOST_BYTES_OF_ALL:
                volumes_m3[mesh.name] = abs(math.prod(mesh.scale)) * stl_volume(file)
        mesh.file = str(file.absolute())  # before a relative one MuJoCo puts folders
    for geom in list(spec.geoms):
        if geom.meshname not in reasons:
            continue
        body, reason = geom.parent, reasons[geom.meshname]
        if not math.isfinite(geom.mass):
            geom.mass = geom.density * volumes_m3.get(geom.meshname, math.nan)
        unread.meshes.setdefault(body.name, []).append(reason)
        if spec.compiler.inertiafromgeom == 1 or not body.explicitinertial:
            unread.uneven.add(body.name)
            if not math.isfinite(geom.mass):
                unread.unweighed.setdefault(body.name, []).append(reason)
        geom.type, geom.meshname, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, "", [NO_SIZE_M, 0, 0]
        geom.fitscale, geom.mass = 1.0, geom.mass if math.isfinite(geom.mass) else 0.0
    for name in reasons:
        spec.delete(found[name][0])
    if reasons:  # without a mesh a body may have no mass, and MuJoCo compiles none of these
        spec.compiler.boundmass, spec.compiler.boundinertia = NO_MASS_KG, NO_MASS_KG * 1e-3
    return unread


def _seem_radians(model: Any) -> bool:
    """Whether most hinges turn by less degrees than a circle has radians."""
    limited = (model.jnt_type == 3) & (model.jnt_limited == 1)
    narrow = np.degrees(np.ptp(model.jnt_range[limited], axis=-1)) < math.tau
    return bool(narrow.sum() > limited.sum() / 2)


def _mesh_file(spec: Any, path: Path, name: str) -> Path | None:
    """File of a mesh by its name in the file: MuJoCo seeks it in the folders that `compiler` names."""
    name = PurePosixPath(name.replace("\\", "/")).name if spec.strippath else name
    own = [path.parent / folder for folder in (spec.meshdir or "", spec.compiler.meshdir or "", "")]
    return find_mesh(name, *dict.fromkeys(own))


class _Reader:
    """Makes links of bodies; a body with several joints becomes a chain of links, the last one its own."""

    def __init__(self, model: Any, unread: _Unread) -> None:
        self._model, self._unread = model, unread
        self._links: list[TreeLink] = []
        self._joints: list[TreeJoint] = []
        #: By body: the name of its link, and the shift from the body's frame to the link's.
        self._made: dict[int, tuple[str, FloatArray]] = {}

    def tree(self, name: str) -> LinkTree:
        root = self._root()
        for body in range(self._model.nbody):
            if body == root:
                self._add_root(body)
            elif self._model.body_parentid[body] in self._made and body and not self._is_free(body):
                self._add(body)
        return tree_of(
            name,
            self._links,
            self._joints,
            stance_rad=self._stance(),
            numbers=self._numbers(),
            left_out_kg=self._left_out_kg(),
        )

    def _is_free(self, body: int) -> bool:
        """Whether a body moves freely: a thing next to a robot on the world."""
        model = self._model
        return bool(model.body_jntnum[body] and model.jnt_type[model.body_jntadr[body]] == 0)

    def _left_out_kg(self) -> dict[str, float]:
        """Masses of bodies that are no part of the robot."""
        masses_kg = self._model.body_mass
        others = (body for body in range(1, len(masses_kg)) if body not in self._made)
        return {
            self._name(body): float(masses_kg[body]) for body in others if masses_kg[body] > 2 * NO_MASS_KG
        }

    def _root(self) -> int:
        """The body on the world that is free or carries 18 hinges; else the world, on which the legs are."""
        model = self._model
        hinges = np.zeros(model.nbody, dtype=int)
        for body in model.jnt_bodyid[model.jnt_type == 3]:
            hinges[model.body_rootid[body]] += 1
        trunk = int(np.argmax(hinges))
        return trunk if hinges[trunk] >= N_JOINTS or self._is_free(trunk) else 0

    def _add_root(self, body: int) -> None:
        self._made[body] = (self._name(body), np.zeros(3))
        self._links.append(self._link(body))

    def _add(self, body: int) -> None:
        model = self._model
        parent, shift_m = self._made[int(model.body_parentid[body])]
        start = frame_of(model.body_pos[body] - shift_m, model.body_quat[body])
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        at_m = np.zeros(3)
        for number, joint in enumerate(joints, start=1):
            anchor_m = np.array(model.jnt_pos[joint]) if model.jnt_type[joint] >= 2 else np.zeros(3)
            frame, start = start @ frame_of(anchor_m - at_m), np.eye(4)
            last, at_m = number == len(joints), anchor_m
            child = self._name(body) if last else f"{self._name(body)}#{number}"
            self._joints.append(self._joint(joint, parent, child, frame))
            if not last:
                self._links.append(TreeLink(child))
            parent = child
        if not len(joints):
            name = self._name(body)
            self._joints.append(TreeJoint(f"fixes {name}", "fixed", parent, name, start))
        self._made[body] = (self._name(body), at_m)
        self._links.append(self._link(body))
        self._add_sites(body)

    def _add_sites(self, body: int) -> None:
        """Add the sites of a body as frames: files mark feet with them."""
        name, shift_m = self._made[body]
        for site in np.flatnonzero(self._model.site_bodyid == body):
            child = f"{name}/{self._model.site(site).name or site}"
            frame = frame_of(self._model.site_pos[site] - shift_m)
            self._links.append(TreeLink(child))
            self._joints.append(TreeJoint(f"fixes {child}", "fixed", name, child, frame))

    def _name(self, body: int) -> str:
        return str(self._model.body(body).name)

    def _link(self, body: int) -> TreeLink:
        model = self._model
        _, shift_m = self._made[body]
        name, turn = self._name(body), matrix_of(model.body_iquat[body])
        tensor, mass_kg = turn @ np.diag(model.body_inertia[body]) @ turn.T, float(model.body_mass[body])
        solids = (self._solid(int(geom), shift_m) for geom in np.flatnonzero(model.geom_bodyid == body))
        return TreeLink(
            name=name,
            mass_kg=mass_kg if mass_kg > 2 * NO_MASS_KG else None,
            com_m=np.array(model.body_ipos[body]) - shift_m,
            inertia_kg_m2=None if name in self._unread.uneven else tensor,
            solids=tuple(solid for solid in solids if solid is not None),
            unread_meshes=tuple(self._unread.meshes.get(name, ())),
            unweighed=tuple(self._unread.unweighed.get(name, ())),
        )

    def _solid(self, geom: int, shift_m: FloatArray) -> Solid | None:
        model = self._model
        frame = frame_of(model.geom_pos[geom] - shift_m, model.geom_quat[geom])
        first, second, third = (float(size) for size in model.geom_size[geom])
        kind = int(model.geom_type[geom])
        if first == NO_SIZE_M:
            return None
        if kind == 7:
            mesh = model.geom_dataid[geom]
            start = model.mesh_vertadr[mesh]
            points = model.mesh_vert[start : start + model.mesh_vertnum[mesh]].astype(float)
            return Solid("mesh", (), frame, points)
        sizes = {
            2: ("sphere", (first,)),
            3: ("capsule", (first, 2 * second)),
            4: ("box", (2 * first, 2 * second, 2 * third)),
            5: ("cylinder", (first, 2 * second)),
            6: ("box", (2 * first, 2 * second, 2 * third)),
        }
        return Solid(*sizes[kind], frame) if kind in sizes else None

    def _joint(self, joint: int, parent: str, child: str, frame: FloatArray) -> TreeJoint:
        model = self._model
        kinds = ("floating", "floating", "prismatic", "revolute")
        kind, dof = kinds[model.jnt_type[joint]], model.jnt_dofadr[joint]
        name = model.joint(joint).name or f"joint{joint}"
        if kind != "revolute":
            return TreeJoint(name, kind, parent, child, frame)
        zero_rad = float(model.qpos0[model.jnt_qposadr[joint]])
        limited = bool(model.jnt_limited[joint])
        return TreeJoint(
            name=name,
            kind="revolute" if limited else "continuous",
            parent=parent,
            child=child,
            frame=frame,
            axis=np.array(model.jnt_axis[joint]),
            limits_rad=tuple((model.jnt_range[joint] - zero_rad).tolist()) if limited else None,
            friction_nm=float(model.dof_frictionloss[dof]),
            # The simulation adds that of gears to every joint.
            damping_nm_s_per_rad=max(0.0, float(model.dof_damping[dof]) - self._gear_damping),
            rotor_inertia_kg_m2=float(model.dof_armature[dof]) or None,
            **self._actuator(joint),
        )

    @property
    def _gear_damping(self) -> float:
        usual = (USUAL_GEAR_DAMPING_NM_S_PER_RAD,)
        return self._numbers().get(GEAR_KEY, usual)[0]

    def _actuator(self, joint: int) -> dict[str, Any]:
        """Torque limit, and stiffness and damping of a position control."""
        model = self._model
        drives = (model.actuator_trntype == 0) & (model.actuator_trnid[:, 0] == joint)
        found: dict[str, float | None] = {"torque_nm": None}
        if model.jnt_actfrclimited[joint]:
            found["torque_nm"] = float(np.abs(model.jnt_actfrcrange[joint]).max())
        for one in np.flatnonzero(drives):
            found["dead_time_s"] = float(model.actuator_delay[one]) or None
            gear, gain = abs(float(model.actuator_gear[one, 0])), float(model.actuator_gainprm[one, 0])
            if model.actuator_forcelimited[one]:
                limit_nm = gear * float(np.abs(model.actuator_forcerange[one]).max())
                found["torque_nm"] = min(limit_nm, found["torque_nm"] or math.inf)
            if model.actuator_biastype[one] == 1 and gain == -model.actuator_biasprm[one, 1]:
                found["stiffness_nm_per_rad"] = gear**2 * gain
                damping = -(gear**2) * float(model.actuator_biasprm[one, 2])
                found["control_nm_s_per_rad"] = damping or None
            elif (
                model.actuator_biastype[one] == 0  # a motor, whose control is its torque
                and model.actuator_ctrllimited[one]
                and not model.actuator_forcelimited[one]
            ):
                limit_nm = gear * gain * float(np.abs(model.actuator_ctrlrange[one]).max())
                found["torque_nm"] = min(limit_nm, found["torque_nm"] or math.inf)
        return found

    def _stance(self) -> dict[str, float]:
        model = self._model
        if not model.nkey:
            return {}
        names = [model.key(index).name for index in range(model.nkey)]
        key = next((names.index(name) for name in STANCES if name in names), 0)
        places = {int(joint): int(model.jnt_qposadr[joint]) for joint in np.flatnonzero(model.jnt_type == 3)}
        return {
            model.joint(joint).name or f"joint{joint}": float(model.key_qpos[key, at] - model.qpos0[at])
            for joint, at in places.items()
        }

    def _numbers(self) -> dict[str, tuple[float, ...]]:
        model, found = self._model, {}
        for index in range(model.nnumeric):
            start = model.numeric_adr[index]
            values = model.numeric_data[start : start + model.numeric_size[index]]
            found[model.numeric(index).name] = tuple(values.tolist())
        return found
