"""The parts of a block: all content of its rows, leg by leg and track by track."""

from collections.abc import Callable, Generator

import numpy as np

from hexctl.recording import paths
from hexctl.recording.rrd import load_rerun
from hexctl.recording.series import SAMPLED, SERVOS, VECTORS
from hexctl.recording.tracks.balance import Tally, send_balance
from hexctl.recording.tracks.columns import Block, LinkColumns, Rows
from hexctl.recording.tracks.course import send_course, send_deviation, send_ribbon, send_trail, send_velocity
from hexctl.recording.tracks.events import send_events
from hexctl.recording.tracks.failures import send_lanes, send_looks, send_suspicion
from hexctl.recording.tracks.gait_tracks import send_feet, send_gait, send_guard, send_phases
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


def _send_vectors(block: Block) -> None:
    """Send the angles of all joints at every tick, in which both are known."""
    both = [block.column(str(series.source)) for series in VECTORS]
    rows = np.flatnonzero(np.isfinite(both).all(axis=(0, 2)))
    if rows.size:
        for series, values in zip(VECTORS, both, strict=True):
            block.send_vectors(series, rows, values[rows])


def _send_samples(block: Block) -> None:
    """Send columns of the log at 10 Hz if known: at every tick they would fill the file."""
    for series in SAMPLED:
        values, rows = block.column(str(series.source)), block.sparse()
        rows = rows[np.isfinite(values[rows]).all(axis=-1)]
        block.plot(series, rows, values[rows])


def _send_servos(block: Block) -> None:
    """Send the reports of servos, if any; an unknown value leaves a gap."""
    readings = block.log.servo_rows.between(block.start, block.stop)
    for series in SERVOS:
        known = [(row, getattr(servos, str(series.source))) for row, servos in readings]
        known = [(row, values) for row, values in known if np.isfinite(values).any()]
        if known:
            values = np.stack([np.where(np.isfinite(values), values, np.nan) for _, values in known])
            block.plot(series, np.array([row for row, _ in known]) - block.start, values)


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
    _send_vectors,
    _send_samples,
    send_velocity,
    send_suspicion,
    send_lanes,
    _send_servos,
)
