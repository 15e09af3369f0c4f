"""The contract of a policy: its joints, observation and actions, with nothing left to guess."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from hexctl.errors import InputError
from hexctl.robot.model import Robot
from hexctl.robot.sensors import Sensor
from hexctl.types import N_JOINTS, N_LEGS, ArrayFields, FloatArray

#: Kinds of observation terms.
Kind = Literal[
    "base_lin_vel",
    "base_ang_vel",
    "projected_gravity",
    "joint_pos_rel",
    "joint_pos_abs",
    "joint_vel",
    "last_action",
    "command",
    "gait_phase",
    "foot_contacts",
]

#: Numbers of a term.
WIDTHS: dict[Kind, int] = {
    "base_lin_vel": 3,
    "base_ang_vel": 3,
    "projected_gravity": 3,
    "joint_pos_rel": N_JOINTS,
    "joint_pos_abs": N_JOINTS,
    "joint_vel": N_JOINTS,
    "last_action": N_JOINTS,
    "command": 3,
    "gait_phase": 2,
    "foot_contacts": N_LEGS,
}

#: Kinds by other names of them in mjlab, Isaac Lab, Unitree's and other programs.
ALIASES: dict[str, Kind] = {
    "lin_vel": "base_lin_vel",
    "ang_vel": "base_ang_vel",
    "gyro": "base_ang_vel",
    "gravity": "projected_gravity",
    "gravity_vec": "projected_gravity",
    "dof_pos": "joint_pos_rel",
    "joint_vel_rel": "joint_vel",
    "dof_vel": "joint_vel",
    "actions": "last_action",
    "velocity_commands": "command",
    "generated_commands": "command",
    "commands": "command",
    "twist": "command",
    "foot_contact": "foot_contacts",
    **{kind: kind for kind in WIDTHS},
}

#: Sensors of which a term needs one; a difference of angles stands for velocities of joints.
NEEDS: Mapping[Kind, tuple[Sensor, ...]] = {
    "base_lin_vel": (),
    "base_ang_vel": ("imu",),
    "projected_gravity": ("imu", "position"),
    "joint_pos_rel": ("joint_positions",),
    "joint_pos_abs": ("joint_positions",),
    "joint_vel": ("joint_velocities", "joint_positions"),
    "foot_contacts": ("foot_contacts",),
}

#: Examples of numbers in place of a term.
STAND_INS: Mapping[Kind, str] = {
    "base_lin_vel": "[0, 0, 0]",
    "base_ang_vel": "[0, 0, 0]",
    "projected_gravity": "[0, 0, -1]",
}

#: Stands for the measurement of a term: the commanded velocity, or the targets of joints.
COMMANDED = "commanded"

#: Terms for which `COMMANDED` may stand.
WITH_COMMANDED: tuple[Kind, ...] = ("base_lin_vel", "joint_pos_rel", "joint_pos_abs", "joint_vel")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Term(ArrayFields):
    """A part of the observation.

    Attributes:
        name: in the file.
        kind: what it observes.
        scale: factor, a number or one for each of its numbers.
        clip: lowest and highest value, (2,), or None.
        scale_first: whether it is scaled before it is clipped.
        history: how many values, the oldest first; the first value stands for those before it.
        joints: of joint terms, index of hexctl's joint of each number, (n,).
        directions: 1, or -1 for joints that turn the other way, (n,).
        zeros_rad: hexctl's angle at the policy's angle 0, (n,).
        offsets_rad: subtracted from relative angles, as the policy counts them, (n,).
        period_s: of a gait phase.
        stand_in: numbers in place of a measurement, `COMMANDED`, or None.
    """

    name: str
    kind: Kind
    scale: FloatArray
    clip: FloatArray | None = None
    scale_first: bool = False
    history: int = 1
    joints: tuple[int, ...] = ()
    directions: FloatArray = field(default_factory=lambda: np.empty(0))
    zeros_rad: FloatArray = field(default_factory=lambda: np.empty(0))
    offsets_rad: FloatArray = field(default_factory=lambda: np.empty(0))
    period_s: float | None = None
    stand_in: FloatArray | str | None = None

    @property
    def width(self) -> int:
        """Numbers of one value."""
        return WIDTHS[self.kind]

    def unmeasured(self, robot: Robot) -> bool:
        """Whether the robot does not measure it and nothing stands for it."""
        needed = NEEDS.get(self.kind)
        return needed is not None and self.stand_in is None and not {*needed} & {*robot.sensors}

    def check(self, robot: Robot) -> None:
        """Raise InputError for a term that the robot does not measure and nothing stands for."""
        if not self.unmeasured(robot):
            return
        needed = " or ".join(NEEDS[self.kind]) or "a velocity that no robot of hexctl measures"
        zeros = STAND_INS.get(self.kind, f"[{self.width} numbers]")
        commanded = f", or {COMMANDED}" if self.kind in WITH_COMMANDED else ""
        raise InputError(
            f"policy: the term {self.name} needs {needed}, and {robot.name} measures "
            f"{', '.join(robot.sensors) or 'nothing'}; allowed: a policy without it, or what to put in its "
            f"place, such as stand_in: {{{self.name}: {zeros}}}{commanded}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PolicyContract(ArrayFields):
    """What a network observes and does. Arrays of joints are (18,), in the order of its actions.

    The target of a joint as the policy counts its angle is clipped scale * action + offset; hexctl's angle is
    direction * target + zero.

    Attributes:
        joints: index of hexctl's joint of each action.
        directions: 1, or -1 for joints that turn the other way than hexctl's.
        zeros_rad: hexctl's angle at the policy's angle 0.
        default_rad: default pose, as the policy counts angles.
        action_scale: rad per action.
        action_offset_rad: target of the action 0, as the policy counts angles.
        action_clip: lowest and highest raw action, which is observed clipped, too, (18, 2), or None.
        target_clip_rad: lowest and highest target, as the policy counts angles, (18, 2), or None.
        terms: of the observation, in order.
        history_by_time: whether histories are joined time by time, not term by term.
        mean: subtracted from the observation, (n,), or None.
        std: divides it then, (n,), or None.
        control_hz: actions per second.
        command_ranges: lowest and highest velocity forward and left in m/s and turn in rad/s, (3, 2); None
            for a policy without a command.
        input: name of the network's input, or None for its only one.
        output: name of the network's output, or None for its only one.
        origin: where it was read.
    """

    joints: tuple[int, ...]
    directions: FloatArray
    zeros_rad: FloatArray
    default_rad: FloatArray
    action_scale: FloatArray
    action_offset_rad: FloatArray
    action_clip: FloatArray | None
    target_clip_rad: FloatArray | None
    terms: tuple[Term, ...]
    history_by_time: bool
    mean: FloatArray | None
    std: FloatArray | None
    control_hz: float
    command_ranges: FloatArray | None
    input: str | None
    output: str | None
    origin: str

    @property
    def observation_size(self) -> int:
        """Numbers of an observation, with histories."""
        return sum(term.width * term.history for term in self.terms)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the numbers of an observation, such as `joint_pos_3`, or `joint_pos_3_ago2`."""
        newest = max(term.history for term in self.terms) - 1
        if not self.history_by_time:
            parts = [(term, ago) for term in self.terms for ago in range(term.history - 1, -1, -1)]
        else:
            parts = [(term, ago) for ago in range(newest, -1, -1) for term in self.terms]
        return tuple(
            f"{term.name}_{number}{f'_ago{ago}' if ago else ''}"
            for term, ago in parts
            for number in range(term.width)
        )

    def joints_rad(self, targets_rad: FloatArray) -> FloatArray:
        """Hexctl's joint angles, (18,), of targets in the order and the angles of the policy."""
        angles_rad: FloatArray = np.empty(N_JOINTS)
        angles_rad[list(self.joints)] = self.directions * targets_rad + self.zeros_rad
        return angles_rad
