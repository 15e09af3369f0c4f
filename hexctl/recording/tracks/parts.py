"""The parts of a block: all content of its rows, leg by leg and track by track."""

from collections.abc import Callable, Generator

import numpy as np

from hexctl.recording import paths
from hexctl.recording.rrd import load_rerun
from hexctl.recording.tracks.balance import Tally, send_balance
from hexctl.recording.tracks.columns import Block, LinkColumns, Rows
from hexctl.recording.tracks.course import send_course, send_deviation, send_ribbon, send_trail, send_velocity
from hexctl.recording.tracks.events import send_events
from hexctl.recording.tracks.failures import send_lanes, send_looks, send_suspicion
from hexctl.recording.tracks.gait_tracks import send_feet, send_gait, send_guard, send_phases
from hexctl.recording.tracks.servo_tracks import send_samples, send_servos, send_vectors
from hexctl.robot.rotations import xyzw
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, FloatArray


def send_parts(block: Block) -> Generator[None, None, Tally]:
    """Send all content of a block part by part, because it takes longer than a tick; return its balance.

    It depends only on these rows and earlier ones: the size of blocks does not change a recording.
    """
    links = LinkColumns(block.stop - block.start)
    for leg in paths.LEGS:
        _send_leg(block, links, leg)
        yield
        send_looks(block, leg)
        yield
    for send in PARTS:
        send(block)
        yield
    return send_balance(block)


def _send_base(block: Block) -> None:
    """Send the pose of the body; until a position is known, at its start."""
    known = np.flatnonzero(block.posed)
    if known.size:
        _send_pose(block, known, block.column("base_position_world")[known], block.quaternions[known])
    # The robot is drawn at one place, but the viewer's eye only follows recurring poses.
    unknown = block.sparse()
    unknown = unknown[
        unknown + block.start < (np.inf if block.log.posed_from is None else block.log.posed_from)
    ]
    if unknown.size:
        height_m = block.subject.robot.standing_height_m
        _send_pose(block, unknown, np.tile([0, 0, height_m], (unknown.size, 1)), block.quaternions[unknown])


def _send_pose(block: Block, rows: Rows, position: FloatArray, quaternion: FloatArray) -> None:
    pose = load_rerun().Transform3D.columns(
        translation=position.astype(np.float32), quaternion=xyzw(quaternion).astype(np.float32)
    )
    block.send(paths.ROBOT, rows, pose)


def _send_leg(block: Block, links: LinkColumns, leg: int) -> None:
    first = JOINTS_PER_LEG * (leg - 1)
    both = [
        block.column(name)[:, first : first + JOINTS_PER_LEG] for name in ("commanded_rad", "measured_rad")
    ]
    joints = np.stack(both, axis=-1)  # (ticks, 3, 2)
    for index, kind in enumerate(JOINT_KINDS):
        block.send(paths.link_path(leg, kind), slice(None), links.columns(kind, joints[:, index]))


#: Tracks after the legs, in this order.
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
    send_vectors,
    send_samples,
    send_velocity,
    send_suspicion,
    send_lanes,
    send_servos,
)
