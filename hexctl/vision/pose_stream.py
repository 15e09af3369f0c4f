"""Turn video into poses, and send them to the robot, a page, a video and a table."""

import csv
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from hexctl.errors import InputError, argument
from hexctl.files import write_new
from hexctl.vision.detection.camera_watch import CameraChange
from hexctl.vision.detection.overlay import with_overlay
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.robot_tracker import SeenRobot
from hexctl.vision.estimation.pose_filter import PoseEstimate, Sight
from hexctl.vision.observer import Observation, Observer
from hexctl.vision.robot_link import RobotLink
from hexctl.vision.video.mjpeg import MjpegServer
from hexctl.vision.video.videos import Frame, VideoSource, VideoWriter

#: Period of poses without pictures.
TELL_S = 0.03

#: Period of the status.
STATUS_S = 1.0

#: How long the video and the page show what happened.
EVENT_S = 3.0

#: Minimum variances, from the accuracy of tags, paper and legs.
LEAST_POSITION_M2, LEAST_YAW_RAD2 = 0.002**2, 0.003**2

#: Columns of the table. `seen_` columns come from this picture only, the others from the filter after it.
COLUMNS = (
    "at_s", "sight", "x_m", "y_m", "yaw_rad", "age_s", "seen_x_m", "seen_y_m", "seen_yaw_rad", "quality"
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStatus:
    """What a camera sees, once a second.

    Attributes:
        estimate: of the robot's pose.
        fps: pictures per second since the last status.
        seen: share of them in which the robot's tag was found.
        quality: of the last sighting since then, 0 to 1; 0 without one.
        tag_px: edge of the tag in it.
    """

    estimate: PoseEstimate
    fps: float
    seen: float
    quality: float
    tag_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraReport:
    """Statistics of a camera.

    Attributes:
        duration_s: total time.
        pictures: number of processed pictures.
        seen: share of them with the robot's tag.
        dropped: pictures of a live camera that arrived during processing.
        restarts: number of restarts because the robot was elsewhere.
        look_s: processor time per picture; None without pictures.
    """

    duration_s: float = 0.0
    pictures: int = 0
    seen: float = 0.0
    dropped: int = 0
    restarts: int = 0
    look_s: float | None = None

    @property
    def fps(self) -> float:
        """Pictures per second."""
        return self.pictures / self.duration_s if self.duration_s > 0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON values, rounded."""
        return {
            "duration_s": round(self.duration_s, 1),
            "pictures": self.pictures,
            "fps": round(self.fps, 1),
            "seen": round(self.seen, 3),
            "dropped": self.dropped,
            "restarts": self.restarts,
            "look_ms": None if self.look_s is None else round(1000 * self.look_s, 1),
        }


class PoseTable:
    """CSV table of poses, one row per picture; unknown values are empty."""

    def __init__(self, path: Path) -> None:
        """Begin a new file. Raises InputError if that fails."""
        write_new(path, f"{','.join(COLUMNS)}\r\n", argument("poses"))
        try:
            self._file = path.open("a", buffering=1, encoding="utf-8", newline="")
        except OSError as error:
            raise InputError(f"{argument('poses')}: {path} cannot be written: {error.strerror}") from error
        self._rows = csv.writer(self._file)

    def write(self, at_s: float, estimate: PoseEstimate, observation: Observation) -> None:
        """Write a row for a picture that came at a time."""
        robot = observation.robot
        age = f"{estimate.age_s:.3f}" if math.isfinite(estimate.age_s) else ""
        row = [f"{at_s:.4f}", estimate.sight, *_numbers(estimate.pose), age]
        row += _numbers(None if robot is None else robot.pose_floor)
        row.append("" if robot is None else f"{robot.quality:.3f}")
        self._rows.writerow(row)

    def close(self) -> None:
        """End the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _numbers(pose: PlanarPose | None) -> list[str]:
    return ["", "", ""] if pose is None else [f"{one:.5f}" for one in (pose.x_m, pose.y_m, pose.yaw_rad)]


class PoseStream:
    """The loop: a picture, the states that came meanwhile, the pose to the robot and the other outputs."""

    def __init__(
        self,
        observer: Observer,
        *,
        robot: RobotLink | None = None,
        page: MjpegServer | None = None,
        video: VideoWriter | None = None,
        table: PoseTable | None = None,
    ) -> None:
        self._observer, self._robot, self._page = observer, robot, page
        self._video, self._table = video, table
        self._pictures = self._seen = self._restarts = 0
        self._look_s = 0.0
        self._last = Observation(None, False, None)
        self._sighted: SeenRobot | None = None
        self._since_accepted = self._misfits = 0
        self._sight: Sight = "lost"
        self._event, self._event_at_s = "", -math.inf

    def run(
        self,
        video: VideoSource,
        stop_requested: Callable[[], bool],
        *,
        on_pose: Callable[[PoseEstimate], None],
        on_status: Callable[[CameraStatus], None],
        on_event: Callable[[str], None],
    ) -> CameraReport:
        """Look until `stop_requested` returns True or the video ends; callbacks as in `RobotCamera.run`."""
        began_s = told_s = time.monotonic()
        told_pictures = told_seen = 0
        shown_s = 0.0

        def tell(text: str) -> None:
            self._event, self._event_at_s = text, shown_s
            on_event(text)

        while not stop_requested() and not video.ended:
            frame = self._fitting(video.read(TELL_S), tell)
            for state in () if self._robot is None else self._robot.states():
                self._observer.listen(state)
            if frame is not None:
                shown_s = frame.at_s
                self._look(frame, tell)
            estimate = self._observer.estimate(time.monotonic() if video.live else shown_s)
            self._tell(estimate, tell)
            if frame is not None:
                on_pose(estimate)
                self._show(frame, estimate)
            now_s = time.monotonic()
            if now_s - told_s >= STATUS_S:
                pictures, seen, robot = self._pictures - told_pictures, self._seen - told_seen, self._sighted
                on_status(
                    CameraStatus(
                        estimate=estimate,
                        fps=pictures / (now_s - told_s),
                        seen=seen / max(1, pictures),
                        quality=0.0 if robot is None else robot.quality,
                        tag_px=0.0 if robot is None else robot.tag.edge_px,
                    )
                )
                told_s, told_pictures, told_seen = now_s, self._pictures, self._seen
                self._sighted = None
        return CameraReport(
            duration_s=time.monotonic() - began_s,
            pictures=self._pictures,
            seen=self._seen / max(1, self._pictures),
            dropped=video.dropped,
            restarts=self._restarts,
            look_s=self._look_s / self._pictures if self._pictures else None,
        )

    def _fitting(self, frame: Frame | None, on_event: Callable[[str], None]) -> Frame | None:
        """A picture of the lens's size, or None: a reconnected camera may have another size."""
        if frame is None:
            return None
        lens, (height_px, width_px) = self._observer.watch.camera.lens, frame.picture.shape[:2]
        if (width_px, height_px) == lens.size_px:
            return frame
        if not self._misfits:
            on_event(
                f"the camera sends pictures of {width_px}x{height_px} px now, and they were "
                f"{lens.width_px}x{lens.height_px}: they are left out; start again to look at them"
            )
        self._misfits += 1
        return None

    def _look(self, frame: Frame, on_event: Callable[[str], None]) -> None:
        began_s = time.process_time()
        self._last = self._observer.look(frame.gray(), frame.at_s)
        self._look_s += time.process_time() - began_s
        self._pictures += 1
        self._seen += self._last.robot is not None
        self._sighted = self._last.robot or self._sighted
        self._since_accepted = 0 if self._last.accepted else self._since_accepted + 1
        if self._last.change is not None:
            on_event(_change_text(self._last.change))

    def _tell(self, estimate: PoseEstimate, on_event: Callable[[str], None]) -> None:
        """Send the pose to the robot, and report when it is lost, found or elsewhere."""
        if estimate.sight != self._sight and "lost" in (estimate.sight, self._sight):
            on_event(
                f"the robot is lost: {self._why_lost()}" if estimate.pose is None else "the robot is seen"
            )
        if estimate.restarts != self._restarts:
            on_event("the robot is not where its legs' motion predicts: was it carried, or did it slip?")
        self._sight, self._restarts = estimate.sight, estimate.restarts
        if self._robot is None or estimate.pose is None or estimate.covariance is None:
            return
        self._robot.publish(
            estimate.pose,
            self._observer.height_m,
            position_variance_m2=max(LEAST_POSITION_M2, float(np.trace(estimate.covariance[:2, :2])) / 2),
            yaw_variance_rad2=max(LEAST_YAW_RAD2, float(estimate.covariance[2, 2])),
        )

    def _why_lost(self) -> str:
        if not self._since_accepted:
            return "no pictures come"
        if self._last.frozen:
            return "the pictures stand still while its legs walk: does the camera hang?"
        if self._last.robot is not None:
            return "its tag is seen, but not accepted: was the camera moved?"
        return "its tag is not seen"

    def _show(self, frame: Frame, estimate: PoseEstimate) -> None:
        if self._table is not None:
            self._table.write(frame.at_s, estimate, self._last)
        looked_at = self._page is not None and self._page.clients > 0
        if self._video is None and not looked_at:
            return
        event_is_recent = frame.at_s - self._event_at_s < EVENT_S
        drawn = with_overlay(
            frame.picture,
            self._observer.watch.camera,
            self._observer.watch.floor_corners,
            sighting=self._last.robot,
            pose_floor=estimate.pose,
            height_m=self._observer.height_m + self._observer.tag.height_m,
            lines=[*_lines(estimate, self._last), *([self._event] if event_is_recent else [])],
        )
        if self._video is not None:
            self._video.write(drawn, frame.at_s)
        if self._page is not None and looked_at:
            good, jpeg = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 80])
            if good:
                self._page.publish(jpeg.tobytes())


def _change_text(change: CameraChange) -> str:
    if change.tag_id is not None:
        return f"tag {change.tag_id} on the floor was moved; it is no longer used"
    turned_deg = math.degrees(change.turned_rad)
    return f"the camera moved by {100 * change.shift_m:.1f} cm, {turned_deg:.1f} deg; its new place is known"


def _lines(estimate: PoseEstimate, observation: Observation) -> list[str]:
    """Text for the picture: the pose and its source."""
    pose, robot = estimate.pose, observation.robot
    where = "pose not known"
    if pose is not None:
        where = f"{pose.x_m:+.3f} {pose.y_m:+.3f} m  {math.degrees(pose.yaw_rad):+.1f} deg"
    if robot is not None:
        doubt = "" if observation.accepted else ", not accepted"
        return [where, f"tag {robot.tag.edge_px:.0f} px, quality {robot.quality:.2f}{doubt}"]
    if pose is None:
        return [where, "tag not seen"]
    return [where, f"tag not seen for {estimate.age_s:.1f} s: by its legs"]
