"""The rows of a log as Rerun columns: whole arrays at once, never tick by tick."""

from typing import Any

import numpy as np

from hexctl.control.log import TickLog
from hexctl.record import paths
from hexctl.record.balance import Tally, send_balance
from hexctl.record.block import Block, Rows, Subject
from hexctl.record.course import send_course, send_deviation, send_ribbon, send_trail
from hexctl.record.events import send_events
from hexctl.record.lanes import send_feet, send_gait, send_guard, send_phases
from hexctl.record.links import LinkColumns
from hexctl.record.scene import xyzw
from hexctl.record.sdk import load_rerun
from hexctl.robot.joints import JOINT_KINDS, JOINTS_PER_LEG

__all__ = ["BlockWriter", "Subject"]


class BlockWriter:
    """Sends rows [start, stop) of a log to a recording stream.

    What is sent depends on the rows and the ones before them only, so a log written in blocks equals the
    same log written at once.

    Attributes:
        block: the rows.
    """

    def __init__(
        self, stream: Any, subject: Subject, log: TickLog, start: int, stop: int, began_at_s: float = 0.0
    ) -> None:
        """Take rows of a log whose first tick was at a time of the wall clock, in s since 1970."""
        self.block = Block(stream, subject, log, start, stop, began_at_s)

    def write(self) -> Tally:
        """Send everything that the rows hold, and return how steady the robot was."""
        block = self.block
        _send_base(block)
        _send_joints(block)
        send_phases(block)
        send_gait(block)
        send_guard(block)
        send_events(block)
        send_feet(block)
        if not block.log.pose_known:
            return Tally()
        send_trail(block)
        send_course(block)
        send_ribbon(block)
        send_deviation(block)
        return send_balance(block)


def _send_base(block: Block) -> None:
    """Send the pose of the body, or put it where a standing robot's is while none is known."""
    rows: Rows = slice(None)
    if block.log.pose_known:
        position, quaternion = block.column("base_position_world"), block.column("base_quaternion_world")
    else:
        # The robot is drawn at one place, but the viewer's eye only follows what comes again and again.
        rows = block.sparse()
        position = np.tile([0, 0, block.subject.robot.standing_height_m], (rows.size, 1))
        quaternion = np.tile([1, 0, 0, 0], (rows.size, 1))
    if len(position):
        pose = load_rerun().Transform3D.columns(
            translation=position.astype(np.float32), quaternion=xyzw(quaternion).astype(np.float32)
        )
        block.send(paths.ROBOT, rows, pose)


def _send_joints(block: Block) -> None:
    """Send each joint's angle as the rotation of its link, and commanded and measured as scalars."""
    joints = np.stack([block.column("sent_rad"), block.column("measured_rad")], axis=-1)  # (ticks, 18, 2)
    links = LinkColumns(len(joints))
    for leg in paths.LEGS:
        for index, kind in enumerate(JOINT_KINDS):
            angles = joints[:, JOINTS_PER_LEG * (leg - 1) + index]
            block.send(paths.link_path(leg, kind), slice(None), links.columns(kind, angles))
