"""Robot files with identified servos and trunk."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import InputError, argument
from hexctl.files import write_new
from hexctl.identify.identification import Identification
from hexctl.identify.parameters import SCALE, RobotValues, play_shares
from hexctl.robot.loader import load_robot_file
from hexctl.robot.model import Robot
from hexctl.robot.yaml_text import with_values, yaml_content
from hexctl.types import JOINT_KINDS

#: Digits of identified values: more than any identification knows.
DIGITS = 4

#: Parameters that a robot file has in each joint.
JOINT_KEYS = ("dry_friction_nm", "max_torque_nm")

#: Parameters of which the file has a value for each joint kind.
RATIOS, PLAY = {"coxa_stiffness_ratio", "femur_stiffness_ratio"}, "play_deg"

JOINT_STIFFNESSES = tuple(f"joints.{kind}.{SCALE}" for kind in JOINT_KINDS)

#: Parameters that a robot file has in its section `servo`.
SERVO_KEYS = (
    "damping_nm_s_per_rad",
    "rotor_inertia_kg_m2",
    "dead_time_s",
    "gear_damping_nm_s_per_rad",
    "load_friction",
)

#: Keys by which a robot file may have the stiffness of a P gain instead.
GAIN_KEYS = ("p_gain", "stiffness_nm_per_rad_per_p_gain")

#: Parameters of the centre of the trunk, which is one key: both are known, or it stays.
CENTRE = {"trunk_com_x_m", "trunk_com_y_m"}

#: Keys of a robot file that a known parameter replaces.
MEASURED = {
    SCALE: ("servo.stiffness_nm_per_rad", *JOINT_STIFFNESSES),
    **dict.fromkeys(RATIOS, JOINT_STIFFNESSES),
    **{name: (f"servo.{name}",) for name in SERVO_KEYS},
    **{name: tuple(f"joints.{kind}.{name}" for kind in JOINT_KINDS) for name in JOINT_KEYS},
    PLAY: tuple(f"joints.{kind}.{PLAY}" for kind in JOINT_KINDS),
    "no_load_speed_rad_s": tuple(f"joints.{kind}.no_load_speed_deg_s" for kind in JOINT_KINDS),
    "trunk_mass_kg": ("body.mass_kg",),
    "trunk_com_x_m": ("body.com_m",),
}


def identified_text(robot_file: str | Path, identified: Identification, folder: Path) -> str:
    """Text of a robot file with the identified values, for a folder; comments stay.

    Parameters that the motions did not determine keep the values of the file. Measured keys are no
    longer `unknown`. Raises InputError for a file that is no robot, or whose ranges the values contradict.
    """
    file = load_robot_file(robot_file)
    text = file.text_in(folder)
    mapping: dict[str, Any] = yaml_content(text)
    known = {name: _rounded(one.value) for name, one in identified.estimates.items() if one.known}
    if not known.keys() >= CENTRE:
        known = {name: value for name, value in known.items() if name not in CENTRE}
    # The identified stiffness is the mean of the joints.
    share = known.get(SCALE, 1.0) / file.robot.stiffness_nm_per_rad.mean()
    changed: dict[str, Any] = {
        "body": _body(mapping["body"], known),
        "joints": _joints(mapping["joints"], known, file.robot),
        "servo": _servo(mapping["servo"], known, share * file.content.servo.stiffness_nm_per_rad, identified),
    }
    if "unknown" in mapping:
        changed["unknown"] = _still_unknown(mapping, known)
    return with_values(text, mapping | changed)


def write_identified(robot_file: str | Path, identified: Identification, output: Path) -> None:
    """Write `identified_text` to a new file, and check that it is a robot."""
    write_new(output, identified_text(robot_file, identified, output.parent), argument("output"))
    try:
        load_robot_file(output)
    except InputError:
        output.unlink()
        raise


def _body(body: Mapping[str, Any], known: Mapping[str, float]) -> dict[str, Any]:
    """Trunk with new mass, to which its moments of inertia are proportional, and centre of mass."""
    changed = dict(body)
    if "trunk_mass_kg" in known:
        changed["mass_kg"] = known["trunk_mass_kg"]
        if "inertia_kg_m2" in body:
            share = changed["mass_kg"] / body["mass_kg"]
            changed["inertia_kg_m2"] = [_rounded(share * moment) for moment in body["inertia_kg_m2"]]
    if known.keys() >= CENTRE:
        height_m = body.get("com_m", (0.0, 0.0, 0.0))[2]
        changed["com_m"] = [known["trunk_com_x_m"], known["trunk_com_y_m"], height_m]
    return changed


def _still_unknown(mapping: Mapping[str, Any], known: Mapping[str, float]) -> list[str]:
    """Unknown keys without the measured ones; a partly measured section is named key by key."""
    measured = {key for name in known for key in MEASURED.get(name, ())}
    left: list[str] = []
    for path in mapping["unknown"]:
        section: Any = mapping
        for name in path.split("."):
            section = section.get(name, {}) if isinstance(section, dict) else {}
        if any(key.startswith(f"{path}.") for key in measured):
            keys = dict.fromkeys(SCALE if key in GAIN_KEYS else key for key in section)
            left += [inner for key in keys if (inner := f"{path}.{key}") not in measured]
        elif path not in measured:
            left.append(path)
    return left


def _servo(
    servo: Mapping[str, Any], known: Mapping[str, float], stiffness: float, identified: Identification
) -> dict[str, Any]:
    new: dict[str, Any] = {}
    if SCALE in known and GAIN_KEYS[0] in servo:
        gain = servo[GAIN_KEYS[0]] if isinstance(identified.fit.values, RobotValues) else identified.p_gain
        new = dict(zip(GAIN_KEYS, (gain, _rounded(stiffness / gain)), strict=True))
    elif SCALE in known:
        new = {SCALE: _rounded(stiffness)}
    return {**servo, **new, **{name: known[name] for name in SERVO_KEYS if name in known}}


def _joints(joints: Mapping[str, Any], known: Mapping[str, float], robot: Robot) -> dict[str, Any]:
    """Joints with new friction, torque, speed, play, and stiffnesses if those of the kinds differ."""
    before = RobotValues.of(robot)
    now = replace(before, **{name: known[name] for name in (SCALE, *RATIOS) if name in known})
    # Torque and speed without load are both proportional to the voltage.
    power = known.get("max_torque_nm", before.max_torque_nm) / before.max_torque_nm
    changed = {kind: dict(joints[kind]) for kind in JOINT_KINDS}
    for index, joint in enumerate(changed.values()):
        joint.update({name: known[name] for name in JOINT_KEYS if name in known})
        speed_deg_s = power * joint.get("no_load_speed_deg_s", np.inf)
        if "no_load_speed_rad_s" in known:
            speed_deg_s = float(np.degrees(known["no_load_speed_rad_s"]))
        if np.isfinite(speed_deg_s):
            joint["no_load_speed_deg_s"] = _rounded(speed_deg_s)
            joint["max_speed_deg_s"] = min(joint["max_speed_deg_s"], _rounded(speed_deg_s))
        if known.keys() & RATIOS or (SCALE in known and SCALE in joint):
            joint[SCALE] = _rounded(now.kind_stiffnesses_nm_per_rad[index])
        if PLAY in known:
            joint[PLAY] = _rounded(known[PLAY] * float(play_shares(robot)[index]))
    return changed


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
