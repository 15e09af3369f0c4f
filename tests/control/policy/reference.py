"""The observation of a policy once more, from its files alone: written apart from hexctl, term by term."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hexctl.types import JOINT_NAMES, FloatArray, RobotState

#: One observed tick: its state, command, last action.
Tick = tuple[RobotState, Sequence[float], FloatArray]


def observation(
    terms: Sequence[dict[str, Any]], ticks: Sequence[Tick], *, by_time: bool = False
) -> FloatArray:
    """Observation at the last of the ticks since the policy began.

    A term has `is`, `scale`, `clip`, `history`, and for joints `names` (a minus before reversed ones) and
    `offsets`; a phase has `period`.
    """
    frames = [[_value(term, ticks, index) for index in range(len(ticks))] for term in terms]
    rows = []
    for term, values in zip(terms, frames, strict=True):
        length = term.get("history", 1)
        padded = [values[0]] * (length - 1) + values
        rows.append(padded[-length:])
    if by_time:
        return np.concatenate([np.concatenate([row[at] for row in rows]) for at in range(len(rows[0]))])
    return np.concatenate([np.concatenate(row) for row in rows])


def _value(term: dict[str, Any], ticks: Sequence[Tick], index: int) -> FloatArray:
    state, command, last = ticks[index]
    kind = term["is"]
    if kind == "gravity":
        assert state.base_quaternion_world is not None
        w, x, y, z = state.base_quaternion_world
        value = Rotation.from_quat([x, y, z, w]).inv().apply([0.0, 0.0, -1.0])
    elif kind == "rate":
        value = np.asarray(state.angular_velocity_body_rad_s)
    elif kind == "command":
        value = np.asarray(command)
    elif kind == "last":
        value = last
    elif kind == "phase":
        turns = 0.02 * index / term["period"]
        value = np.array([np.sin(2 * np.pi * turns), np.cos(2 * np.pi * turns)])
    else:
        value = np.array([_of_joint(kind, name, state) for name in term["names"]])
        value = value - np.asarray(term.get("offsets", 0.0))
    low, high = term.get("clip") or (-np.inf, np.inf)
    return np.asarray(np.clip(value, low, high) * np.asarray(term.get("scale", 1.0)))


def _of_joint(kind: str, name: str, state: RobotState) -> float:
    sign, joint = (-1, name[1:]) if name.startswith("-") else (1, name)
    values = state.joint_positions_rad if kind == "position" else state.joint_velocities_rad_s
    assert values is not None
    return sign * float(values[JOINT_NAMES.index(joint)])
