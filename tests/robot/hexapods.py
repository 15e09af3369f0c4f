"""Robot descriptions for tests: a plain six-legged URDF, of which each part can be replaced."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

from hexctl.robot.formats.importing import mjcf_process
from hexctl.robot.formats.importing.robot_import import ImportedRobot, import_robot

#: Coxa axes in m and yaws in degrees.
MOUNTS = (
    (0.11, 0.05, 40),
    (0.0, 0.08, 90),
    (-0.11, 0.05, 140),
    (-0.11, -0.05, -140),
    (0, -0.08, -90),
    (0.11, -0.05, -40),
)
COXA_M, FEMUR_M, TIBIA_M = 0.045, 0.075, 0.12

LIMIT = '<limit lower="-1.5" upper="1.5" effort="2" velocity="5"/>'


def inertial(mass: str, xx: str, yy: str, zz: str) -> str:
    """Mass and moments of inertia."""
    moments = f'ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"'
    return f'<inertial><mass value="{mass}"/><inertia {moments}/></inertial>'


INERTIAL, TRUNK = inertial("0.05", "4e-5", "5e-5", "5e-5"), inertial("1.2", "0.005", "0.007", "0.01")
SHIN = (
    f'<visual><origin xyz="{TIBIA_M / 2} 0 0" rpy="0 {math.pi / 2} 0"/><geometry>'
    f'<cylinder radius="0.007" length="{TIBIA_M}"/></geometry></visual>'
)


def solid(shape: str, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    """A visual."""
    return f'<visual><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry></visual>'


BOX = solid('<box size="0.22 0.18 0.05"/>')


def fixed(name: str, parent: str, inside: str = "", xyz: str = "0 0 0", kind: str = "fixed") -> str:
    """A link with something in it, on another link."""
    return (
        f'<link name="{name}">{inside}</link><joint name="on_{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{name}"/><origin xyz="{xyz}"/><axis xyz="1 0 0"/></joint>'
    )


def hexapod(
    *,
    trunk: str = "",
    trunk_inertial: str = TRUNK,
    inertial: str = INERTIAL,
    shin: str = SHIN,
    more: str = "",
    more_per_leg: str = "",
    root_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    root_rpy: str = "0 0 0",
    limits: tuple[str, str, str] = (LIMIT, LIMIT, LIMIT),
    dynamics: str = "",
    foot_y_m: float = 0.0,
    foot: str = "fixed",
    mounts: Sequence[tuple[float, float, float]] = MOUNTS,
) -> str:
    """A URDF whose trunk is at -`root_m` and turned: a root anywhere. `{n}` is the number of a leg."""
    x, y, z = root_m
    trunk_at = f'<origin xyz="{-x} {-y} {-z}" rpy="{root_rpy}"/>'
    parts = [
        f'<robot name="some"><link name="root"/><link name="base">{trunk_inertial}{trunk}</link>',
        f'<joint name="r" type="fixed"><parent link="root"/><child link="base"/>{trunk_at}</joint>',
    ]
    for n, (at_x, at_y, yaw) in enumerate(mounts, start=1):
        places = (
            f'xyz="{at_x} {at_y} 0" rpy="0 0 {math.radians(yaw)}"',
            f'xyz="{COXA_M} 0 0"',
            f'xyz="{FEMUR_M} 0 0" rpy="0 1.1 0"',
        )
        names, axes = ("base", f"c{n}", f"f{n}", f"t{n}"), ("0 0 1", "0 -1 0", "0 -1 0")
        for index, (place, axis) in enumerate(zip(places, axes, strict=True)):
            child, solids = names[index + 1], shin if index == 2 else ""
            parts += [
                f'<link name="{child}">{inertial}{solids}</link><joint name="j{child}" type="revolute">',
                f'<parent link="{names[index]}"/><child link="{child}"/><origin {place}/>',
                f'<axis xyz="{axis}"/>{limits[index]}{dynamics}</joint>',
            ]
        if foot:
            parts.append(fixed(f"foot{n}", f"t{n}", xyz=f"{TIBIA_M} {foot_y_m} 0", kind=foot))
        parts.append(more_per_leg.replace("{n}", str(n)))
    return "".join([*parts, more, "</robot>"])


def imported(folder: Path, text: str, **options: Any) -> ImportedRobot:
    """What is made of a description, a URDF or an MJCF; MuJoCo runs in this process, which saves time."""
    path = folder / ("some.xml" if text.startswith("<mujoco") else "some.urdf")
    path.write_text(text, encoding="utf-8")
    with patch.object(mjcf_process, "_answer", mjcf_process.answer_here):
        return import_robot(path, **options)
