"""A third-party MJCF, compiled by MuJoCo, as a tree of links and joints."""

import math
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import InputError, MissingExtraError
from hexctl.files import is_file, read_file
from hexctl.robot.formats.importing.import_values import LEAST_MASS_KG
from hexctl.robot.formats.importing.link_tree import (
    MOST_BYTES,
    MOST_LINKS,
    LinkTree,
    Solid,
    TreeJoint,
    TreeLink,
    tree_of,
)
from hexctl.robot.formats.mjcf import GEAR_KEY
from hexctl.robot.rotations import frame_of, matrix_of
from hexctl.robot.schema import USUAL_GEAR_DAMPING_NM_S_PER_RAD
from hexctl.types import N_JOINTS, FloatArray

#: Keyframes in which a robot stands; else the first one counts.
STANCES = ("stance", "stand", "home")


def read_mjcf(path: Path) -> LinkTree:
    """Tree of an MJCF file; raises InputError for no valid MJCF, MissingExtraError without MuJoCo."""
    try:
        from hexctl.mujoco_import import mujoco
    except ModuleNotFoundError as error:
        raise MissingExtraError("importing an MJCF", "sim") from error
    try:
        read_file(path, MOST_BYTES)
        spec = mujoco.MjSpec.from_file(str(path))
        _name_bodies(spec.bodies)
        unread = _without_missing_files(spec, path.parent)
        model = spec.compile()
        if model.nbody > MOST_LINKS:
            raise ValueError(f"got {model.nbody} bodies; allowed: a robot of up to {MOST_LINKS}")
        if spec.compiler.degree and _seem_radians(model):
            raise ValueError(
                "most hinges turn by less than 6.3 deg: if their ranges are radians, the file needs "
                '<compiler angle="radian"/>'
            )
        return _Reader(model, unread).tree(spec.modelname)
    except (OSError, ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: {reason}; allowed: a valid MJCF") from error


def _name_bodies(bodies: Sequence[Any]) -> None:
    """Give bodies without a name one that is free."""
    used = {body.name for body in bodies}
    free = (name for name in map("body{}".format, count()) if name not in used)
    for body in bodies:
        body.name = body.name or next(free)


def _without_missing_files(spec: Any, folder: Path) -> dict[str, list[str]]:
    """Remove looks, height fields and meshes whose files are missing; return the meshes by body.

    Sensors and contact pairs, which may name a removed solid, are not needed.
    """
    for one in (*spec.geoms, *spec.sites, *spec.tendons):
        one.material = ""
    reliefs = [geom for geom in spec.geoms if geom.hfieldname]
    looks = (*spec.skins, *spec.materials, *spec.textures)
    for one in (*spec.sensors, *spec.pairs, *reliefs, *spec.hfields, *looks):
        spec.delete(one)
    missing = {
        mesh.name: mesh for mesh in spec.meshes if mesh.file and not _is_there(spec, folder, mesh.file)
    }
    unread: dict[str, list[str]] = {}
    for geom in list(spec.geoms):
        if geom.meshname in missing:
            file = missing[geom.meshname].file
            unread.setdefault(geom.parent.name, []).append(f"{file} (not found)")
            spec.delete(geom)
    for mesh in missing.values():
        spec.delete(mesh)
    if missing:  # without a mesh a body may have no mass, and MuJoCo compiles none of these
        spec.compiler.boundmass, spec.compiler.boundinertia = LEAST_MASS_KG * 1e-6, LEAST_MASS_KG * 1e-9
    return unread


def _seem_radians(model: Any) -> bool:
    """Whether most hinges turn by less degrees than a circle has radians."""
    limited = (model.jnt_type == 3) & (model.jnt_limited == 1)
    narrow = np.degrees(np.ptp(model.jnt_range[limited], axis=-1)) < math.tau
    return bool(narrow.sum() > limited.sum() / 2)


def _is_there(spec: Any, folder: Path, file: str) -> bool:
    return any(
        is_file(folder / part / file) for part in ("", spec.meshdir or "", spec.compiler.meshdir or "")
    )


class _Reader:
    """Makes links of bodies; a body with several joints becomes a chain of links, the last one its own."""

    def __init__(self, model: Any, unread: dict[str, list[str]]) -> None:
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
            elif self._model.body_parentid[body] in self._made and body:
                self._add(body)
        return tree_of(name, self._links, self._joints, stance_rad=self._stance(), numbers=self._numbers())

    def _root(self) -> int:
        """The body on the world that carries 18 hinges or more; else the world, on which the legs are."""
        model = self._model
        hinges = np.zeros(model.nbody, dtype=int)
        for body in model.jnt_bodyid[model.jnt_type == 3]:
            hinges[model.body_rootid[body]] += 1
        trunk = int(np.argmax(hinges))
        return trunk if hinges[trunk] >= N_JOINTS else 0

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
        turn = matrix_of(model.body_iquat[body])
        solids = (self._solid(int(geom), shift_m) for geom in np.flatnonzero(model.geom_bodyid == body))
        return TreeLink(
            name=self._name(body),
            mass_kg=float(model.body_mass[body]),
            com_m=np.array(model.body_ipos[body]) - shift_m,
            inertia_kg_m2=turn @ np.diag(model.body_inertia[body]) @ turn.T,
            solids=tuple(solid for solid in solids if solid is not None),
            unread_meshes=tuple(self._unread.get(self._name(body), ())),
        )

    def _solid(self, geom: int, shift_m: FloatArray) -> Solid | None:
        model = self._model
        frame = frame_of(model.geom_pos[geom] - shift_m, model.geom_quat[geom])
        first, second, third = (float(size) for size in model.geom_size[geom])
        kind = int(model.geom_type[geom])
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
