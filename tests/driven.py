"""Simulated robots that are driven by commands: what their joints say, and where they truly are."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from hexctl.backends.sim.servos import SimServos
from hexctl.control.drive.drive import Drive
from hexctl.robot.failure import Failure
from hexctl.robot.rotations import yaw_rad
from hexctl.types import BoolArray, FloatArray

#: A command: for how long in s, and the shares of the greatest velocity forward, left and in turn.
Command = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Driven:
    """A drive, tick by tick.

    Attributes:
        times_s: (T,), from 0.
        joints_rad: as measured, (T, 18).
        contacts: which feet touch the floor, (T, 6).
        poses: true x and y in m and unwrapped yaw in rad, (T, 3).
        height_m: true height of the body frame above the floor of a flat world, (T,).
    """

    times_s: FloatArray
    joints_rad: FloatArray
    contacts: BoolArray
    poses: FloatArray
    height_m: FloatArray

    @property
    def motions(self) -> FloatArray:
        """True motions from tick to tick in the body's frame, (T - 1, 3)."""
        moved = np.diff(self.poses[:, :2], axis=0) @ np.array([1, 1j])
        moved = moved * np.exp(-1j * self.poses[:-1, 2])
        return np.stack([moved.real, moved.imag, np.diff(self.poses[:, 2])], axis=1)


@cache
def driven(
    robot: str,
    commands: tuple[Command, ...],
    *,
    world: str = "flat",
    gait: str = "tripod",
    failure: Failure | None = None,
    told: bool = True,
) -> Driven:
    """A robot that stood up and was then driven by commands; untold of a failure it walks on as if whole."""
    servos = SimServos(robot, world=world, failures=failure)
    rows = []
    recovery = None if told else "walk-on"
    with Drive(servos=servos, gait=gait, failure=failure, failures_known=told, recovery=recovery) as drive:
        drive.reset()
        for duration_s, *shares in commands:
            velocity = drive.share(*shares)
            drive.command(velocity.forward_m_s, velocity.left_m_s, velocity.turn_rad_s)
            for _ in range(round(duration_s * 50)):
                state = drive.step()
                assert servos.true_pose is not None
                assert state.foot_contacts is not None
                position, quaternion = servos.true_pose
                joints_rad, contacts = state.joint_positions_rad.copy(), state.foot_contacts.copy()
                rows.append((joints_rad, contacts, position, float(yaw_rad(quaternion))))
    joints, contacts, positions, yaws = (np.array(column) for column in zip(*rows, strict=True))
    poses = np.column_stack([positions[:, :2], np.unwrap(yaws)])
    return Driven(0.02 * np.arange(len(rows), dtype=float), joints, contacts, poses, positions[:, 2])


def course(motions: FloatArray) -> FloatArray:
    """Poses (T, 3) after motions (T - 1, 3) from the origin."""
    yaw = np.concatenate([[0.0], np.cumsum(motions[:, 2])])
    moved = np.cumsum((motions[:, :2] @ np.array([1, 1j])) * np.exp(1j * yaw[:-1]))
    points = np.concatenate([[0.0], moved])
    return np.column_stack([points.real, points.imag, yaw])
