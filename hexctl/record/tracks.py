"""The rows of a log as Rerun columns: whole arrays at once, never tick by tick."""

from collections.abc import Callable, Iterator
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
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, FloatArray


class BlockWriter:
    """Sends rows [start, stop) of a log to a recording stream.

    What is sent depends on the rows and the ones before them only, so a log written in blocks equals the
    same log written at once.

    Attributes:
        block: the rows.
        tally: how steady the robot was, once all is sent.
    """

    def __init__(
        self, stream: Any, subject: Subject, log: TickLog, start: int, stop: int, began_at_s: float = 0.0
    ) -> None:
        """Take rows of a log whose first tick was at a time of the wall clock, in s since 1970."""
        self.block = Block(stream, subject, log, start, stop, began_at_s)
        self.tally = Tally()

    def write(self) -> Tally:
        """Send everything that the rows hold, and return how steady the robot was."""
        for _ in self.steps():
            pass
        return self.tally

    def steps(self) -> Iterator[None]:
        """Send everything part by part: a robot in mid-stride has no time for all of it at once."""
        block, links = self.block, LinkColumns(self.block.stop - self.block.start)
        for leg in paths.LEGS:
            _send_leg(block, links, leg)
            yield
        for send in PARTS:
            send(block)
            yield
        self.tally = send_balance(block)


def _send_base(block: Block) -> None:
    """Send the pose of the body; until one is known for the first time, a standing robot's."""
    known = np.flatnonzero(block.posed)
    if known.size:
        pose = block.column("base_position_world")[known], block.column("base_quaternion_world")[known]
        _send_pose(block, known, *pose)
    # The robot is drawn at one place, but the viewer's eye only follows what comes again and again.
    unknown = block.sparse()
    unknown = unknown[
        unknown + block.start < (np.inf if block.log.posed_from is None else block.log.posed_from)
    ]
    if unknown.size:
        height_m = block.subject.robot.standing_height_m
        pose = np.tile([0, 0, height_m], (unknown.size, 1)), np.tile([1, 0, 0, 0], (unknown.size, 1))
        _send_pose(block, unknown, *pose)


def _send_pose(block: Block, rows: Rows, position: FloatArray, quaternion: FloatArray) -> None:
    pose = load_rerun().Transform3D.columns(
        translation=position.astype(np.float32), quaternion=xyzw(quaternion).astype(np.float32)
    )
    block.send(paths.ROBOT, rows, pose)


def _send_leg(block: Block, links: LinkColumns, leg: int) -> None:
    """Send each joint's angle as the rotation of its link, and commanded and measured as scalars."""
    first = JOINTS_PER_LEG * (leg - 1)
    both = [block.column(name)[:, first : first + JOINTS_PER_LEG] for name in ("sent_rad", "measured_rad")]
    joints = np.stack(both, axis=-1)  # (ticks, 3, 2)
    for index, kind in enumerate(JOINT_KINDS):
        block.send(paths.link_path(leg, kind), slice(None), links.columns(kind, joints[:, index]))


#: What is sent after the legs, in this order.
PARTS: tuple[Callable[[Block], None], ...] = (
    _send_base,
    send_phases,
    send_gait,
    send_guard,
    send_events,
    send_feet,
    send_trail,
    send_course,
    send_ribbon,
    send_deviation,
)
