"""Tracks of a recording over time: robot, path, gait diagram, guard, events, support polygon."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.clock import PERIOD_S
from hexctl.control.log import TickLog
from hexctl.control.result import TrialResult
from hexctl.control.trace import PHASES, TrialFrame
from hexctl.ik.legs import link_points_body
from hexctl.ik.support_polygon import carried, centre_of_mass_of, support, to_world
from hexctl.record import paths, style
from hexctl.record.columns import (
    KEPT_BITS,
    SPARSE_TICKS,
    TORQUE_BITS,
    Block,
    LinkColumns,
    Rows,
    Subject,
    compact,
    posed_rows,
    rounded,
)
from hexctl.record.failure_tracks import failure_lines, send_lanes, send_looks, send_suspicion
from hexctl.record.rrd import load_rerun
from hexctl.record.scene import course_world, on_floor, path_end_m, xyzw
from hexctl.record.servo_tracks import send_servos
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG, N_JOINTS, BoolArray, FloatArray

#: An arrow is as long as the robot goes in this time.
ARROW_S = 2.0
ARROW_RADIUS_M = 0.006

#: The ribbon is made of pieces of this many ticks: fewer, longer ones than the trail's, each is a mesh.
RIBBON_TICKS = 10


def send_trail(block: Block) -> None:
    """Send the way of the body, on the floor, as short pieces; those before the time cursor are drawn."""
    at, first = _pieces(block, SPARSE_TICKS)
    if at.size:
        positions = block.log.rows("base_position_world", first, block.stop)[:, :2]
        ends = (on_floor(positions[index], block.subject.floor) for index in (at - SPARSE_TICKS, at))
        pieces = np.stack(list(ends), axis=1).astype(np.float32)
        block.send(paths.TRAIL, at + first - block.start, load_rerun().LineStrips3D.columns(strips=pieces))


def send_course(block: Block) -> None:
    """Send the line of travel where the walk begins."""
    subject, frame = block.subject, block.log.frame
    rows = block.changes(block.led("phase"))
    rows = rows[block.column("phase")[rows] == PHASES.index("walk")]
    if frame is not None and rows.size and np.isfinite(frame.origin_world).all():
        length_m = float(np.linalg.norm(path_end_m(subject.robot, subject.plan)))
        line = course_world(frame, length_m, subject.floor).astype(np.float32)
        block.send(paths.COURSE, rows, load_rerun().LineStrips3D.columns(strips=[line]))


def send_ribbon(block: Block) -> None:
    """Send the area between the line of travel and the trail, coloured by side, in pieces as the trail."""
    frame, rr = block.log.frame, load_rerun()
    at, first = _pieces(block, RIBBON_TICKS)
    walking = block.log.rows("phase", first, block.stop) == PHASES.index("walk")
    at = at[walking[at] & walking[at - RIBBON_TICKS]]
    if frame is None or not at.size:
        return
    positions = block.log.rows("base_position_world", first, block.stop)[:, :2]
    ends = [_across(frame, positions[index]) for index in (at - RIBBON_TICKS, at)]
    corners = np.concatenate([on for pair in ends for on in pair], axis=-1).reshape(-1, 2)
    quads = compact(on_floor(corners, block.subject.floor))
    left = frame.path(_with_height(positions[at]))[:, 1] >= 0
    colors = np.where(left, style.packed(style.LEFT_COLOR), style.packed(style.RIGHT_COLOR))
    columns = [
        *rr.Mesh3D.columns(vertex_positions=quads).partition(np.full(at.size, 4)),
        *rr.Mesh3D.columns(albedo_factor=colors.astype(np.uint32)),
    ]
    block.send(paths.RIBBON, at + first - block.start, columns)


def send_deviation(block: Block) -> None:
    """Send the distance from the line of travel during the walk, positive to its left."""
    frame = block.log.frame
    rows = np.flatnonzero(block.in_walk() & block.posed)
    if frame is not None and rows.size:
        deviation = frame.path(block.column("base_position_world")[rows])[:, 1]
        columns = load_rerun().Scalars.columns(scalars=rounded(deviation, KEPT_BITS))
        block.send(paths.DEVIATION, rows, columns)


def send_torques(block: Block) -> None:
    """Send the torques of all joints now and then, where they are known: at every tick they fill the file."""
    torques_nm, rows = block.column("joint_torques_nm"), block.sparse()
    rows = rows[np.isfinite(torques_nm[rows]).all(axis=-1)]
    if rows.size:
        scalars = load_rerun().Scalars.columns(scalars=rounded(torques_nm[rows], TORQUE_BITS).ravel())
        block.send(paths.TORQUES, rows, scalars.partition(np.full(rows.size, N_JOINTS)))


def send_velocity(block: Block) -> None:
    """Send the velocity that a steered walk commands now and then, as scalars and as an arrow."""
    velocity, rows, rr = block.column("velocity_body"), block.sparse(), load_rerun()
    rows = rows[np.isfinite(velocity[rows]).all(axis=-1)]
    if not rows.size:
        return
    scalars = rr.Scalars.columns(scalars=rounded(velocity[rows], KEPT_BITS).ravel())
    block.send(paths.VELOCITY, rows, scalars.partition(np.full(rows.size, 3)))
    # Not as static data: an arrow without a vector is an error of the scene, and open-loop walks have none.
    arrows = rr.Arrows3D.columns(
        vectors=compact(ARROW_S * np.column_stack([velocity[rows, :2], np.zeros(rows.size)])),
        origins=np.tile([0.0, 0.0, block.subject.robot.body.size_m[2]], (rows.size, 1)),
        colors=np.full(rows.size, style.packed(style.COURSE_COLOR), dtype=np.uint32),
        radii=np.full(rows.size, ARROW_RADIUS_M),
    )
    block.send(paths.VELOCITY_ARROW, rows, arrows)


def _pieces(block: Block, step: int) -> tuple[NDArray[np.int64], int]:
    """Ends of the pieces between ticks that are multiples of a step, (N,), and the tick they count from.

    Only pieces whose ends are known count. The ends count from that tick of the log, which is the one that
    the first piece begins at.
    """
    first = max(block.start, step)
    first += -first % step - step
    at = np.arange(step, block.stop - first, step)
    posed = posed_rows(block.log, first, block.stop)
    return at[posed[at] & posed[at - step]], first


def _across(frame: TrialFrame, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Horizontal positions, (N, 2), and the nearest points on the line of travel."""
    along = np.array([np.cos(frame.heading_rad), np.sin(frame.heading_rad)])
    progress = frame.path(_with_height(points_m))[:, :1]
    return points_m, frame.origin_world[:2] + progress * along


def _with_height(points_m: FloatArray) -> FloatArray:
    return np.column_stack([points_m, np.zeros(len(points_m))])


#: Targets that differ by less count as unchanged: they were rounded on their way.
ROUNDING_RAD = 1e-5

#: Ticks for which a foot's contact must differ from the command to be shown: rebounds are left out.
STEADY_TICKS = 5


def clipped_joints(wanted_rad: FloatArray, sent_rad: FloatArray) -> BoolArray:
    """Whether the guard changed each joint's target, any shape."""
    return np.asarray(np.abs(sent_rad - wanted_rad) > ROUNDING_RAD)


def skipped_ticks(time_s: FloatArray) -> FloatArray:
    """Number of periods missed before each tick, (ticks,)."""
    return np.asarray(np.maximum(np.round(np.diff(time_s, prepend=time_s[:1]) / PERIOD_S) - 1, 0))


def send_phases(block: Block) -> None:
    """Send the parts of the trial where they begin."""
    rows = block.changes(block.led("phase"))
    if rows.size:
        names = np.array(PHASES)[block.column("phase")[rows]]
        block.send(paths.PHASE, rows, load_rerun().StateChange.columns(state=names))


def send_gait(block: Block) -> None:
    """Send stance and swing of each foot where they change, as commanded and, if it is felt, as they are."""
    states = _felt(block) if block.log.contacts_known else block.led_swing.astype(int)
    names = np.array(style.FELT_STATES if block.log.contacts_known else style.COMMANDED_STATES)
    lead = len(states) - (block.stop - block.start)
    for leg in paths.LEGS:
        rows = block.changes(states[:, leg - 1])
        if rows.size:
            state = names[states[rows + lead, leg - 1]]
            block.send(paths.gait_path(leg), rows, load_rerun().StateChange.columns(state=state))


def _felt(block: Block) -> NDArray[np.int64]:
    """States of the feet as indices of `style.FELT_STATES`, preceded by one row, (rows + 1, 6)."""
    swing = block.swing(STEADY_TICKS)
    other = steadily(swing == block.led("foot_contacts", STEADY_TICKS))
    states = 2 * swing.astype(np.int64) + (swing == other)
    return np.asarray(states[max(min(block.start, STEADY_TICKS) - 1, 0) :])


def steadily(is_so: BoolArray) -> BoolArray:
    """Whether a value has been true for the last `STEADY_TICKS` rows, same shape."""
    steady = is_so.copy()
    for back in range(1, STEADY_TICKS):
        steady[back:] &= is_so[:-back]
        steady[:back] = False
    return steady


def send_feet(block: Block) -> None:
    """Send which feet touch the floor, where that changes, as the foot's colour; one for all if unfelt."""
    touching = block.led("foot_contacts")
    felt = (style.LIFTED_COLOR, style.TOUCHING_COLOR)
    shown = felt if block.log.contacts_known else (style.UNFELT_COLOR, style.UNFELT_COLOR)
    colors = np.array([style.packed(color) for color in shown], dtype=np.uint32)
    for leg in paths.LEGS:
        rows = block.changes(touching[:, leg - 1])
        if rows.size:
            color = colors[block.column("foot_contacts")[rows, leg - 1].astype(int)]
            block.send(paths.foot_path(leg), rows, load_rerun().Points3D.columns(colors=color))


def send_guard(block: Block) -> None:
    """Send where the guard changed targets and where the clock missed ticks."""
    states = clipped_joints(block.led("wanted_rad"), block.led("sent_rad")).any(axis=-1).astype(int)
    states[skipped_ticks(block.led("time_s")) > 0] = 2
    lead = len(states) - (block.stop - block.start)
    rows = block.changes(states)
    if rows.size:
        names = np.array(style.GUARD_STATES)[states[rows + lead]]
        block.send(paths.GUARD, rows, load_rerun().StateChange.columns(state=names))


#: A row of the block, how grave it is in Rerun's words, and what it was.
Event = tuple[int, str, str]

INFO, WARNING, ERROR = "INFO", "WARN", "ERROR"

#: Statuses of trials that ended early, and the reason of a requested stop, which is not a fault.
STOPS = ("fell", "diverged", "aborted")
REQUESTED = "requested"

#: More joints than this are counted, not named.
MAX_NAMES = 3


def send_events(block: Block) -> None:
    """Send what happened in the rows of a block."""
    parts = (_phases(block), _failures(block), _notes(block), _clipped(block), _skipped(block))
    events = sorted((event for part in parts for event in part), key=lambda event: event[0])
    if events:
        rows, levels, texts = zip(*events, strict=True)
        columns = load_rerun().TextLog.columns(text=list(texts), level=list(levels))
        block.send_at(paths.EVENTS, [block.start + row for row in rows], columns)


def _phases(block: Block) -> Iterator[Event]:
    for row in block.changes(block.led("phase")).tolist():
        yield row, INFO, f"{PHASES[block.column('phase')[row]]} begins"


def _failures(block: Block) -> Iterator[Event]:
    """Legs that the world let fail or heal, in the tick before the first that shows it."""
    for row, text in failure_lines(block):
        yield row - block.start, WARNING, text


def _notes(block: Block) -> Iterator[Event]:
    """What the controller noticed and did."""
    for row, text in block.log.notes:
        if block.start <= row < block.stop:
            yield row - block.start, WARNING, text


def _clipped(block: Block) -> Iterator[Event]:
    """Ticks at which the guard began to change targets, with the first joints concerned."""
    led = clipped_joints(block.led("wanted_rad"), block.led("sent_rad"))
    lead = len(led) - (block.stop - block.start)
    for row in block.changes(led.any(axis=-1)).tolist():
        names = [name for name, clipped in zip(JOINT_NAMES, led[row + lead], strict=True) if clipped]
        if names:
            more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
            yield row, WARNING, f"clipped: {', '.join(names[:MAX_NAMES])}{more}"


def _skipped(block: Block) -> Iterator[Event]:
    """Ticks before which periods were missed because the previous tick took too long."""
    led = skipped_ticks(block.led("time_s"))
    lead = len(led) - (block.stop - block.start)
    for row in np.flatnonzero(led[lead:]).tolist():
        missed = int(led[row + lead])
        ticks = "1 tick" if missed == 1 else f"{missed} ticks"
        yield row, WARNING, f"missed {ticks}: the one before took too long"


def send_outcome(last: Block, result: TrialResult) -> None:
    """Send how the trial ended, at the last tick of its last block; the guard's lane shows a stop too."""
    rr, row = load_rerun(), np.array([last.stop - last.start - 1])
    why = f": {result.stopped}" if result.stopped else ""
    stopped = result.status in STOPS and result.stopped != REQUESTED
    level = ERROR if stopped else WARNING if result.status == "no_progress" else INFO
    columns = rr.TextLog.columns(text=[f"trial over, {result.status}{why}"], level=[level])
    last.send(paths.EVENTS, row, columns)
    if stopped:
        last.send(paths.GUARD, row, rr.StateChange.columns(state=[style.STOPPED]))


#: The polygon lies this much above the ribbon and the line, and the mark of the centre above the polygon.
POLYGON_M, MARK_M = np.array([0.0, 0.0, 0.001]), np.array([0.0, 0.0, 0.002])


@dataclass(frozen=True, slots=True)
class Tally:
    """In how many ticks of the walk the centre of gravity is known, and in how many the feet carry it."""

    walked: int = 0
    inside: int = 0

    def __add__(self, other: "Tally") -> "Tally":
        return Tally(self.walked + other.walked, self.inside + other.inside)

    @property
    def share(self) -> float | None:
        """Share of the walk with the centre of gravity inside the support polygon; None before the walk."""
        return self.inside / self.walked if self.walked else None


def send_balance(block: Block) -> Tally:
    """Send the polygon, the centre of gravity and its margin now and then; count all ticks of the walk."""
    feet, centres = _feet_and_centres(block)
    known = np.asarray(np.isfinite(centres).all(axis=-1))
    rows = block.sparse()
    rows = rows[known[rows]]
    if rows.size:
        found = support(feet[rows], block.standing[rows], centres[rows, :2])
        inside = np.asarray(found.margin_m > 0)
        _send_polygon(block, rows, found.corners, inside)
        _send_centre(block, rows, centres[rows], inside)
        _send_margin(block, rows, found.margin_m)
    counted = np.flatnonzero(known & block.in_walk())
    inside = carried(feet[counted], block.standing[counted], centres[counted, :2])
    return Tally(counted.size, int(inside.sum()))


def _feet_and_centres(block: Block) -> tuple[FloatArray, FloatArray]:
    """Horizontal foot positions, (rows, 6, 2), and centres of gravity, (rows, 3), in the world."""
    robot = block.subject.robot
    links = link_points_body(robot, block.column("measured_rad"))
    centre = centre_of_mass_of(robot, links)[:, np.newaxis]
    pose = block.column("base_position_world"), block.column("base_quaternion_world")
    points = to_world(np.concatenate([links[..., -1, :], centre], axis=1), *pose)
    return points[:, :-1, :2], points[:, -1]


def _send_polygon(block: Block, rows: NDArray[np.int64], corners: FloatArray, inside: BoolArray) -> None:
    rr, count = load_rerun(), corners.shape[1]
    raised = on_floor(corners.reshape(-1, 2), block.subject.floor) + POLYGON_M
    points = compact(raised).reshape(-1, count, 3)
    columns = [
        *rr.Mesh3D.columns(vertex_positions=points.reshape(-1, 3)).partition(np.full(rows.size, count)),
        *rr.Mesh3D.columns(albedo_factor=_colors(inside, style.STEADY_FILL, style.UNSTEADY_FILL)),
    ]
    block.send(paths.POLYGON, rows, columns)


def _send_centre(block: Block, rows: NDArray[np.int64], centres: FloatArray, inside: BoolArray) -> None:
    """Send the mark on the floor and the plumb line that it hangs on."""
    rr = load_rerun()
    marks = on_floor(centres[:, :2], block.subject.floor) + MARK_M
    color = _colors(inside, style.STEADY_COLOR, style.UNSTEADY_COLOR)
    lines = np.stack([compact(marks), compact(centres)], axis=1)
    columns = [
        *rr.Points3D.columns(positions=lines[:, 0], colors=color),
        *rr.LineStrips3D.columns(strips=lines),
    ]
    block.send(paths.CENTRE, rows, columns)


def _send_margin(block: Block, rows: NDArray[np.int64], margin_m: FloatArray) -> None:
    """Send how far inside the polygon the centre is, where there is one."""
    finite = np.isfinite(margin_m)
    if finite.any():
        columns = load_rerun().Scalars.columns(scalars=rounded(margin_m[finite], KEPT_BITS))
        block.send(paths.MARGIN, rows[finite], columns)


def _colors(inside: BoolArray, steady: style.Color, unsteady: style.Color) -> NDArray[np.uint32]:
    """Colour of each row as Rerun packs it."""
    colors = np.array([style.packed(unsteady), style.packed(steady)], dtype=np.uint32)
    return np.asarray(colors[inside.astype(int)])


class BlockWriter:
    """Sends rows [start, stop) of a log to a recording stream.

    The output depends only on these rows and earlier ones, so a log written in blocks equals the same log
    written in one piece.

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
        """Send everything part by part: all of it takes longer than a tick of a walking robot."""
        block, links = self.block, LinkColumns(self.block.stop - self.block.start)
        for leg in paths.LEGS:
            _send_leg(block, links, leg)
            yield
            send_looks(block, leg)
            yield
        for send in PARTS:
            send(block)
            yield
        self.tally = send_balance(block)


def _send_base(block: Block) -> None:
    """Send the pose of the body; until a position is known, at its start."""
    known = np.flatnonzero(block.posed)
    if known.size:
        _send_pose(block, known, block.column("base_position_world")[known], block.quaternions[known])
    # The robot is drawn at one place, but the viewer's eye only follows what comes again and again.
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
    send_torques,
    send_velocity,
    send_suspicion,
    send_lanes,
    send_servos,
)
