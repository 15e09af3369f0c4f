"""Two walks as a race: one scene with a lane for each, a fixed camera, and a line of text on each walk."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexctl.export.captions import Message, Picture, TextBar, color_changes_s, even_pixels, messages_of
from hexctl.export.render import (
    PIECE_TICKS,
    Canvas,
    PosedRobot,
    add_box,
    add_geom,
    add_line,
    add_trail,
    positions_m,
    quaternions,
)
from hexctl.palette import GREY, LINE_COLOR, Color
from hexctl.recording.recorded_trial import RecordedTrial
from hexctl.robot.rotations import product
from hexctl.types import FloatArray

#: Elevations of the fixed camera in degrees.
CAMERAS = {"side": 34.0, "top": 88.0}
#: Vertical angle of view: a narrow one shows both lanes in nearly the same size.
FOVY_DEG = 7.0
#: Brightness of the light from above.
LIGHT = 0.55

#: Width of a lane, and margin around the course, in stance radii of the larger robot.
LANE_SHARE, ROOM_SHARE = 2.3, 1.5
#: Limits of the scene's height, as shares of its width.
LOWEST, HIGHEST = 0.3, 0.8

#: The finish line is where the winner is this long before the end, on a multiple of `FINISH_STEP_M`.
CHEER_S, FINISH_STEP_M = 1.2, 0.05

#: Length of the lanes beyond the picture.
BEYOND_M = 9.0

#: Squares of the finish line, and the distance from paint to lanes and from lanes to floor.
SQUARE_M, PAINT_M = 0.03, 0.002

#: Projection onto the floor along the light, and the minimum opacity for a shadow.
FLATTEN = np.array([[1.0, 0.0, -0.2], [0.0, 1.0, 0.3], [0.0, 0.0, 0.01]])
SOLID = 0.5

SHADOW_COLOR: Color = (36, 42, 52)
LANE_COLORS: tuple[Color, Color] = ((58, 67, 80), (68, 79, 94))
WHITE: Color = (236, 240, 245)
BLACK: Color = (12, 14, 18)
WON_BADGE: Color = (0, 138, 88)


class Racer:
    """A walk in a lane along its line of travel; `start_s` is in the recording, `progress_m` is (T,)."""

    def __init__(self, trial: RecordedTrial, start_s: float, lane_m: float) -> None:
        self.trial, self.start_s = trial, start_s
        axes, origin = _lane_axes(trial)
        self._positions_m = (positions_m(trial) - origin) @ axes.T + [0.0, lane_m, 0.0]
        self._turn, self._quaternions = _quaternion_of(axes), quaternions(trial)
        self._robot = PosedRobot(trial.robot, np.array([1.0, 0.0, 0.0, 0.0]))
        self.model, self.data = self._robot.model, self._robot.data
        self.progress_m = self._positions_m[:, 0] if trial.posed.any() else None

    def row(self, time_s: float) -> int:
        """Tick at a time of the film."""
        return self.trial.row_at(time_s + self.start_s)

    def place(self, row: int) -> None:
        """Put the robot at its pose of a tick."""
        turned, trial = product(self._turn, self._quaternions[row]), self.trial
        at_m, conditions = self._positions_m[row], trial.leg_conditions[row]
        self._robot.place(at_m, turned, trial.measured_rad[row], conditions)

    def trail_m(self, row: int) -> FloatArray:
        """Path of the body until a tick, just above the floor, (N, 3); NaN before its walk began."""
        at = np.arange(0, row + 1, PIECE_TICKS)
        way = self._positions_m[at].copy()
        way[:, 2] = self.trial.robot.foot_radius_m / 4
        way[(self.trial.walk_s[at] <= 0) | ~self.trial.posed[at]] = np.nan
        return way

    def distance_m(self, time_s: float) -> float:
        """Distance along the line at a time of the film, or NaN."""
        return math.nan if self.progress_m is None else float(self.progress_m[self.row(time_s)])


class RaceRenderer:
    """Draws two walks in one scene at times of a film. Close it: its context belongs to this thread."""

    def __init__(
        self,
        trials: Sequence[RecordedTrial],
        starts_s: Sequence[float],
        captions: Sequence[str],
        times_s: Sequence[float],
        *,
        camera: str,
        width_px: int,
    ) -> None:
        """Lay out the lanes, the first trial on the far one; raises what `open_context` raises."""
        self._reach_m = max(trial.robot.stance_radius_m for trial in trials)
        self._lane_m = LANE_SHARE * self._reach_m
        sides = (self._lane_m / 2, -self._lane_m / 2)
        lanes = zip(trials, starts_s, sides, strict=True)
        self.racers = [Racer(trial, start_s, side_m) for trial, start_s, side_m in lanes]
        self._course = _Course.of(self.racers, times_s)
        self._bars = [
            TextBar(caption, width_px, self._course.messages(racer))
            for caption, racer in zip(captions, self.racers, strict=True)
        ]
        self._elevation_deg = CAMERAS[camera]
        height_px = even_pixels(width_px * self._height_share())
        self._open(width_px, height_px)

    def _open(self, width_px: int, height_px: int) -> None:
        self._canvas = Canvas(width_px, height_px)
        import mujoco

        model = self.racers[0].model
        model.vis.global_.fovy, model.light_diffuse[:] = FOVY_DEG, LIGHT
        self._mujoco, self._scene = mujoco, self._canvas.new_scene(model)
        self._look, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation = 90.0, -self._elevation_deg
        low_m, high_m = self._span_m()
        half_m = (high_m - low_m) / 2 * height_px / width_px
        self._camera.distance = half_m / math.tan(math.radians(FOVY_DEG / 2))
        self._camera.lookat = ((low_m + high_m) / 2, 0.0, self._top_m() / 2)

    def _span_m(self) -> tuple[float, float]:
        room_m = ROOM_SHARE * self._reach_m
        return self._course.start_m - room_m, self._course.end_m + room_m

    def _top_m(self) -> float:
        return 1.4 * max(racer.trial.robot.standing_height_m for racer in self.racers)

    def _height_share(self) -> float:
        low_m, high_m = self._span_m()
        elevation = math.radians(self._elevation_deg)
        tall_m = 2.04 * self._lane_m * math.sin(elevation) + self._top_m() * math.cos(elevation)
        return min(max(tall_m / (high_m - low_m), LOWEST), HIGHEST)

    def moments_s(self) -> list[float]:
        """Times of the film at which a message appears, or a leg changes its colour."""
        changes_s = [at_s - racer.start_s for racer in self.racers for at_s in color_changes_s(racer.trial)]
        return [*changes_s, *(message.at_s for bar in self._bars for message in bar.messages)]

    def picture(self, time_s: float) -> Picture:
        """Picture at a time of the film, (height, width, 3): the far lane's text is on top."""
        rows = [racer.row(time_s) for racer in self.racers]
        self._draw_robots(rows)
        self._draw_shadows()
        self._draw_lanes()
        for racer, row in zip(self.racers, rows, strict=True):
            add_trail(self._scene, racer.trail_m(row), racer.trial.robot.foot_radius_m / 2)
        scene = self._canvas.draw(self._scene)
        walked_m = [racer.distance_m(time_s) - self._course.start_m for racer in self.racers]
        far, near = (
            bar.draw(time_s, f"{bar_m:.2f} m" if math.isfinite(bar_m) else "")
            for bar, bar_m in zip(self._bars, walked_m, strict=True)
        )
        return np.vstack([far, scene, near])

    def _draw_robots(self, rows: Sequence[int]) -> None:
        """The first robot brings the floor and the light of its model."""
        mujoco, parts = self._mujoco, self._mujoco.mjtCatBit
        for racer, row in zip(self.racers, rows, strict=True):
            racer.place(row)
        first, second = self.racers
        mujoco.mjv_updateScene(
            first.model, first.data, self._look, None, self._camera, parts.mjCAT_ALL, self._scene
        )
        untouched = mujoco.MjvPerturb()
        mujoco.mjv_addGeoms(
            second.model, second.data, self._look, untouched, int(parts.mjCAT_DYNAMIC), self._scene
        )

    def _draw_shadows(self) -> None:
        """Flattened solids: MuJoCo's own shadows take twice the time."""
        dynamic = int(self._mujoco.mjtCatBit.mjCAT_DYNAMIC)
        for geom in list(self._scene.geoms[: self._scene.ngeom]):
            if geom.category == dynamic and geom.rgba[3] > SOLID:
                at_m = FLATTEN @ geom.pos + [0.0, 0.0, 3 * PAINT_M]
                add_geom(self._scene, geom.type, SHADOW_COLOR, geom.size, at_m, FLATTEN @ geom.mat)

    def _draw_lanes(self) -> None:
        low_m, high_m = self._span_m()
        width_m, foot_m = self._lane_m, self.racers[0].trial.robot.foot_radius_m
        for side, color in zip((0, -1), LANE_COLORS, strict=True):
            near_m = side * width_m
            add_box(
                self._scene,
                (low_m - BEYOND_M, near_m, -PAINT_M),
                (high_m + BEYOND_M, near_m + width_m, PAINT_M),
                color,
            )
            middle_m = near_m + width_m / 2
            begin, end = (np.array([x_m, middle_m, 0.0]) for x_m in (low_m - BEYOND_M, high_m + BEYOND_M))
            add_line(self._scene, begin, end, foot_m / 3, LINE_COLOR)
        for edge_m in (-width_m, 0.0, width_m):
            self._paint((low_m - BEYOND_M, edge_m), (high_m + BEYOND_M, edge_m + 0.006), GREY)
        start_m = self._course.start_m
        self._paint((start_m - 0.006, -width_m), (start_m + 0.006, width_m), WHITE)
        if self._course.finish_m is not None:
            self._draw_finish(self._course.finish_m)

    def _draw_finish(self, finish_m: float) -> None:
        squares = round(2 * self._lane_m / SQUARE_M)
        size_m = 2 * self._lane_m / squares
        for column in range(2):
            for square in range(squares):
                corner = finish_m + (column - 1) * size_m, square * size_m - self._lane_m
                color = WHITE if (column + square) % 2 else BLACK
                self._paint(corner, (corner[0] + size_m, corner[1] + size_m), color)

    def _paint(self, low_m: tuple[float, float], high_m: tuple[float, float], color: Color) -> None:
        add_box(self._scene, (*low_m, 0.0), (*high_m, 2 * PAINT_M), color)

    def close(self) -> None:
        """Free the context."""
        self._canvas.close()


@dataclass(frozen=True, slots=True)
class _Course:
    """Extent of the race from the rearmost body, its finish line and winner, if any."""

    start_m: float
    end_m: float
    finish_m: float | None
    won: tuple[Racer, float] | None

    @classmethod
    def of(cls, racers: Sequence[Racer], times_s: Sequence[float]) -> "_Course":
        ways_m = np.array([[racer.distance_m(time_s) for time_s in times_s] for racer in racers])
        ways_m = np.nan_to_num(ways_m)
        start_m, end_m = float(ways_m[:, 0].min()), float(ways_m.max())
        cheer_s = max(times_s[0], times_s[-1] - CHEER_S)
        then = int(np.searchsorted(times_s, cheer_s))
        lead_m = float(ways_m[:, then].max()) - start_m
        whole_m = FINISH_STEP_M * math.floor(lead_m / FINISH_STEP_M)
        if whole_m <= 0:
            return cls(start_m, end_m, None, None)
        finish_m = start_m + whole_m
        arrivals = [np.flatnonzero(trail_m >= finish_m) for trail_m in ways_m]
        at_s = [times_s[found[0]] if found.size else math.inf for found in arrivals]
        winner = None if at_s[0] == at_s[1] else (racers[int(at_s[1] < at_s[0])], min(at_s))
        return cls(start_m, end_m, finish_m, winner)

    def messages(self, racer: Racer) -> list[Message]:
        found = list(messages_of(racer.trial, racer.start_s))
        if self.won is not None and self.won[0] is racer:
            found.append(Message(self.won[1], "wins", WON_BADGE, math.inf))
        return sorted(found, key=lambda message: message.at_s)


def _lane_axes(trial: RecordedTrial) -> tuple[FloatArray, FloatArray]:
    """Axes of a lane as rows, (3, 3), and its origin: along the line, to its left, up from the floor."""
    up = trial.floor_normal_world
    if trial.course_world is None:
        return np.eye(3), np.zeros(3)
    along = trial.course_world[1] - trial.course_world[0]
    along = along - up * (along @ up)
    along /= np.linalg.norm(along)
    return np.array([along, np.cross(up, along), up]), trial.course_world[0]


def _quaternion_of(axes: FloatArray) -> FloatArray:
    """Orientation whose rotation has these rows, (4,) as w, x, y, z."""
    import mujoco

    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    return quaternion
