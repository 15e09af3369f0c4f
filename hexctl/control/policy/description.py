"""A contract against a robot, line by line, with what does not match."""

import math
from typing import Any

import numpy as np

from hexctl.control.policy.contract import COMMANDED, PolicyContract, Term
from hexctl.control.policy.observation import DIFFERENCE_DELAY_S
from hexctl.control.policy.policy import Policy
from hexctl.control.policy.policy_motion import default_pose_rad
from hexctl.errors import InputError
from hexctl.ik.legs import feet_of_joint_angles
from hexctl.robot.model import Robot
from hexctl.types import JOINT_NAMES, FloatArray

#: Largest difference of the heights of feet in a default pose, as a share of the standing height.
UNEVEN = 0.25


def describe(policy: Policy, robot: Robot) -> dict[str, Any]:
    """JSON values of a contract: `rate_hz`, `joints`, `terms`, `command`, `normaliser`, and `problems`."""
    contract = policy.contract
    return {
        "policy": policy.name,
        "contract": contract.origin,
        "robot": robot.name,
        "rate_hz": contract.control_hz,
        "joints": _joints(contract, robot),
        "terms": [_term(term, robot) for term in contract.terms],
        "observation_size": contract.observation_size,
        "history_order": "by time" if contract.history_by_time else "by term",
        "normaliser": "mean and std of the contract"
        if contract.mean is not None
        else "none outside the network",
        "command": _command(contract),
        "problems": problems(policy, robot),
    }


def problems(policy: Policy, robot: Robot) -> list[str]:
    """What of a contract does not match a robot, in sentences; empty if all does."""
    found = []
    for term in policy.contract.terms:
        try:
            term.check(robot)
        except InputError as error:
            found.append(str(error))
    try:
        pose_rad = default_pose_rad(policy, robot)
    except InputError as error:
        return [*found, str(error)]
    if (uneven := _uneven(robot, pose_rad)) is not None:
        found.append(uneven)
    outside = _outside(policy.contract, robot)
    if outside:
        found.append(
            f"the action 0 is beyond the range of {', '.join(outside)}; check offset_rad and its order"
        )
    return found


def _uneven(robot: Robot, pose_rad: FloatArray) -> str | None:
    """Line about a default pose whose feet are not level: the order or a direction of joints is wrong."""
    feet = feet_of_joint_angles(robot, pose_rad)
    heights_m, usual = feet[:, 2], np.median(feet[:, 2])
    most_m = UNEVEN * robot.standing_height_m
    off = np.abs(heights_m - usual)
    if off.max() <= most_m and -usual > most_m:
        return None
    legs = ", ".join(str(leg + 1) for leg in np.flatnonzero(off > most_m).tolist()) or "1 to 6"
    return (
        f"in the default pose the feet of legs {legs} are {100 * max(off.max(), most_m + usual):.1f} cm off "
        "where they stand; check the order, directions, zeros and the unit (rad) of the joints"
    )


def _outside(contract: PolicyContract, robot: Robot) -> list[str]:
    angles_rad = contract.joints_rad(contract.action_offset_rad)
    outside = (angles_rad < robot.joint_lower_rad) | (angles_rad > robot.joint_upper_rad)
    return [JOINT_NAMES[joint] for joint in np.flatnonzero(outside).tolist()]


def _joints(contract: PolicyContract, robot: Robot) -> list[dict[str, Any]]:
    pose_rad = contract.joints_rad(contract.default_rad)
    stance = robot.stance_angles_rad
    return [
        {
            "action": action,
            "joint": JOINT_NAMES[joint],
            "direction": "+" if contract.directions[action] > 0 else "-",
            "zero_deg": _deg(contract.zeros_rad[action]),
            "default_deg": _deg(pose_rad[joint]),
            "stance_deg": _deg(stance[joint]),
            "offset_deg": _deg(contract.action_offset_rad[action]),
            "scale": round(float(contract.action_scale[action]), 4),
        }
        for action, joint in enumerate(contract.joints)
    ]


def _term(term: Term, robot: Robot) -> dict[str, Any]:
    return {
        "term": term.name,
        "is": term.kind,
        "numbers": f"{term.width} x {term.history}" if term.history > 1 else str(term.width),
        "scale": _numbers(term.scale),
        "clip": None if term.clip is None else _numbers(term.clip),
        "from": _source(term, robot),
    }


def _source(term: Term, robot: Robot) -> str:
    if term.unmeasured(robot):
        return "not measured"
    if term.stand_in is not None:
        return COMMANDED if isinstance(term.stand_in, str) else f"stand-in {_numbers(term.stand_in)}"
    if term.kind == "joint_vel" and "joint_velocities" not in robot.sensors:
        return f"differences of angles, {1000 * DIFFERENCE_DELAY_S:g} ms late"
    return SOURCES[term.kind]


SOURCES = {
    "base_ang_vel": "the IMU",
    "projected_gravity": "the orientation",
    "joint_pos_rel": "the servos, less the default pose",
    "joint_pos_abs": "the servos",
    "joint_vel": "the servos",
    "last_action": "the policy",
    "command": "the command",
    "gait_phase": "the clock",
    "foot_contacts": "the feet",
}


def _command(contract: PolicyContract) -> dict[str, list[float]] | None:
    if contract.command_ranges is None:
        return None
    names = ("forward_m_s", "left_m_s", "turn_rad_s")
    return dict(zip(names, contract.command_ranges.tolist(), strict=True))


def _deg(angle_rad: float) -> float:
    return round(math.degrees(float(angle_rad)), 1) + 0.0


def _numbers(values: FloatArray) -> str:
    texts = [f"{value:g}" for value in np.atleast_1d(values).tolist()]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts[:4]) + (" ..." if len(texts) > 4 else "")
