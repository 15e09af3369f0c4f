"""The parts of a block: all content of its rows, leg by leg and track by track."""

from collections.abc import Callable, Generator
from functools import partial

import numpy as np

from hexctl.columns import FINE_BITS, RECORDED, Column
from hexctl.recording import paths
from hexctl.recording.rrd import load_rerun
from hexctl.recording.series import ORIENTATION, SENSORS, SERVOS, VECTORS, Series, rounded, series_of
from hexctl.recording.tracks.balance import Tally, send_balance
from hexctl.recording.tracks.block import DRAWN_BITS, DRAWN_TICKS, Block, Rows, turn_column
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
    for leg in paths.LEGS:
        _send_leg(block, leg)
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
    place, turn = (rounded(values, FINE_BITS).astype(np.float32) for values in (position, xyzw(quaternion)))
    pose = load_rerun().Transform3D.columns(translation=place, quaternion=turn)
    block.send(paths.ROBOT, rows, pose)


def _send_orientation(block: Block) -> None:
    """Send the orientation, NaN if unknown, where the drawn body does not show it."""
    quaternion = block.column("base_quaternion_world")
    rows = np.flatnonzero(block.posed != np.isfinite(quaternion[:, 0]))
    block.send_numbers(ORIENTATION, rows, quaternion[rows])


def _send_leg(block: Block, leg: int) -> None:
    """Send measured angles as rotations of the links, if they change visibly."""
    first = JOINTS_PER_LEG * (leg - 1)
    led_rad = rounded(block.led("measured_rad", DRAWN_TICKS), DRAWN_BITS)
    lead = len(led_rad) - (block.stop - block.start)
    rows = np.arange(-block.start % DRAWN_TICKS, len(led_rad) - lead, DRAWN_TICKS)
    for joint, kind in enumerate(JOINT_KINDS, start=first):
        angles_rad = led_rad[:, joint]
        # Before the first row there is none, which differs from all.
        before = angles_rad[rows + lead - DRAWN_TICKS] if lead else np.append(np.nan, angles_rad[rows[:-1]])
        changed = rows[angles_rad[rows + lead] != before]
        if changed.size:
            column = turn_column(kind, angles_rad[changed + lead])
            block.send(paths.link_path(leg, kind), changed, [column])


def _send_vectors(block: Block) -> None:
    """Send the angles of all joints at every tick."""
    for series in VECTORS:
        block.send_vectors(series, block.column(series.source))


def _send_column(column: Column, series: Series, block: Block) -> None:
    """Send the numbers of a column of the log."""
    rows = block.sparse(column.ticks)
    block.plot(series, rows, block.column(column.name)[rows])


def _send_own(block: Block) -> None:
    """Send the columns that a controller adds, each with the names of its numbers."""
    for column in block.log.own_columns:
        if block.start <= block.log.own_from < block.stop:
            block.send_names(column.entity or column.name, column.parts)
        _send_column(column, series_of(column), block)


def _send_servos(block: Block) -> None:
    """Send the reports of servos, if any."""
    readings = block.log.servo_rows.between(block.start, block.stop)
    rows = np.array([row - block.start for row, _ in readings], dtype=np.int64)
    for series in SERVOS if readings else ():
        block.plot(series, rows, np.stack([getattr(servos, series.source) for _, servos in readings]))


#: Tracks after the legs, in this order.
PARTS: tuple[Callable[[Block], None], ...] = (
    _send_base,
    _send_orientation,
    send_phases,
    send_gait,
    send_guard,
    send_events,
    send_feet,
    send_trail,
    send_course,
    send_ribbon,
    send_deviation,
    *(partial(_send_column, *pair) for pair in zip(RECORDED, SENSORS, strict=True)),
    send_velocity,
    send_suspicion,
    send_lanes,
    _send_servos,
    _send_own,
    _send_vectors,  # last, because a reader takes the ticks from it: they have all else
)
