"""The rows of a log as Rerun columns: whole arrays at once, never tick by tick."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.sim.terrain import Floor
from hexctl.control.log import PHASES, TickLog
from hexctl.control.plan import TrialPlan
from hexctl.record import paths, style
from hexctl.record.links import LinkColumns
from hexctl.record.scene import course_world, on_floor, path_end_m, xyzw
from hexctl.record.sdk import load_rerun
from hexctl.robot.joints import JOINT_KINDS, JOINTS_PER_LEG
from hexctl.robot.model import Robot

#: The trail is drawn in pieces of this many ticks.
TRAIL_STEP = 5

Rows = NDArray[np.int64] | slice


@dataclass(frozen=True, slots=True)
class Subject:
    """Who walks, what it shall do, and on what floor."""

    robot: Robot
    plan: TrialPlan
    floor: Floor


class BlockWriter:
    """Sends rows [start, stop) of a log to a recording stream.

    What is sent depends on the rows and the ones before them only, so a log written in blocks equals the
    same log written at once.
    """

    def __init__(self, stream: Any, subject: Subject, log: TickLog, start: int, stop: int) -> None:
        self._rr = load_rerun()
        self._stream = stream
        self._subject = subject
        self._log = log
        self._start, self._stop = start, stop
        elapsed_s = self._column("time_s") - log.rows("time_s", 0, 1)
        self._times = np.round(elapsed_s * 1e9).astype("timedelta64[ns]")

    def write(self) -> None:
        """Send everything that the rows hold."""
        self._send_base()
        self._send_joints()
        if self._log.contacts_known:
            self._send_contacts()
        self._send_phases()
        if self._log.pose_known:
            self._send_trail()
            self._send_course()
            self._send_deviation()

    def _send_base(self) -> None:
        """Send the pose of the body, or put it where a standing robot's is while none is known."""
        rr = self._rr
        if self._log.pose_known:
            position, quaternion = self._column("base_position_world"), self._column("base_quaternion_world")
            rows = slice(None)
        elif self._start == 0:
            position, quaternion = (
                np.array([[0, 0, self._subject.robot.standing_height_m]]),
                np.array([[1, 0, 0, 0]]),
            )
            rows = slice(0, 1)
        else:
            return
        pose = rr.Transform3D.columns(
            translation=position.astype(np.float32), quaternion=xyzw(quaternion).astype(np.float32)
        )
        self._send(paths.ROBOT, rows, pose)

    def _send_joints(self) -> None:
        """Send each joint's angle as the rotation of its link, and commanded and measured as scalars."""
        joints = np.stack([self._column("sent_rad"), self._column("measured_rad")], axis=-1)
        joints = joints.astype(np.float32)  # (ticks, 18, 2)
        links = LinkColumns(self._subject.robot, len(joints))
        for leg in paths.LEGS:
            for index, kind in enumerate(JOINT_KINDS):
                angles = joints[:, JOINTS_PER_LEG * (leg - 1) + index]
                self._send(paths.link_path(leg, kind), slice(None), links.columns(kind, angles))

    def _send_contacts(self) -> None:
        """Send which feet touch the floor, where that changes, as a state and as the foot's colour."""
        rr = self._rr
        touching = self._column("foot_contacts")
        names = np.array([style.LIFTED, style.TOUCHING])
        colors = np.array([_packed(style.LIFTED_COLOR), _packed(style.TOUCHING_COLOR)], dtype=np.uint32)
        for leg in paths.LEGS:
            rows = self._changes("foot_contacts", leg - 1)
            if rows.size:
                state = touching[rows, leg - 1].astype(int)
                self._send(paths.contact_path(leg), rows, rr.StateChange.columns(state=names[state]))
                self._send(paths.foot_path(leg), rows, rr.Points3D.columns(colors=colors[state]))

    def _send_phases(self) -> None:
        """Send the parts of the trial where they begin."""
        rows = self._changes("phase")
        if rows.size:
            names = np.array(PHASES)[self._column("phase")[rows]]
            self._send(paths.PHASE, rows, self._rr.StateChange.columns(state=names))

    def _send_trail(self) -> None:
        """Send the way of the body, on the floor, as short pieces; those before the time cursor are drawn."""
        first = max(self._start, TRAIL_STEP)
        rows = np.arange(first + -first % TRAIL_STEP, self._stop, TRAIL_STEP)
        if rows.size:
            before = int(rows[0]) - TRAIL_STEP
            positions = self._log.rows("base_position_world", before, self._stop)[:, :2]
            at = rows - before
            ends = (on_floor(positions[index], self._subject.floor) for index in (at - TRAIL_STEP, at))
            pieces = np.stack(list(ends), axis=1).astype(np.float32)
            self._send(paths.TRAIL, rows - self._start, self._rr.LineStrips3D.columns(strips=pieces))

    def _send_course(self) -> None:
        """Send the line of travel where the walk begins."""
        subject, frame = self._subject, self._log.frame
        rows = self._changes("phase")
        rows = rows[self._column("phase")[rows] == PHASES.index("walk")]
        if frame is not None and rows.size:
            length_m = float(np.linalg.norm(path_end_m(subject.robot, subject.plan)))
            line = course_world(frame, length_m, subject.floor).astype(np.float32)
            self._send(paths.COURSE, rows, self._rr.LineStrips3D.columns(strips=[line]))

    def _send_deviation(self) -> None:
        """Send the distance from the line of travel during the walk, positive to its left."""
        frame = self._log.frame
        rows = np.flatnonzero(self._column("phase") == PHASES.index("walk"))
        if frame is not None and rows.size:
            deviation = frame.path(self._column("base_position_world")[rows])[:, 1]
            values = deviation.astype(np.float32).astype(np.float64)
            self._send(paths.DEVIATION, rows, self._rr.Scalars.columns(scalars=values))

    def _changes(self, name: str, *index: int) -> NDArray[np.int64]:
        """Return the rows of the block in which a value differs from the row before, and the first tick."""
        before = max(self._start - 1, 0)
        values = self._log.rows(name, before, self._stop)[(slice(None), *index)]
        changed = np.flatnonzero(values[1:] != values[:-1]) + 1 - (self._start - before)
        return changed if self._start else np.concatenate([[0], changed])

    def _column(self, name: str) -> Any:
        """Return the block's rows of a column."""
        return self._log.rows(name, self._start, self._stop)

    def _send(self, path: str, rows: Rows, columns: Any) -> None:
        """Send columns for rows counted from the start of the block."""
        times = self._rr.TimeColumn(paths.TIMELINE, duration=self._times[rows])
        self._stream.send_columns(path, [times], columns, strict=True)


def _packed(color: tuple[int, int, int]) -> int:
    """Return a colour as Rerun packs it, 0xRRGGBBAA."""
    red, green, blue = color
    return red << 24 | green << 16 | blue << 8 | 0xFF
