"""Pictures of a rendered camera: taken at a constant rate, and delivered as late as they should be."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from queue import Queue
from typing import Any

import cv2
import numpy as np

from hexctl.simulators.camera.camera_faults import faulty_camera, is_covered, parse_camera_fault, with_hand
from hexctl.simulators.camera.posture_history import PostureHistory
from hexctl.simulators.camera.rendering import RobotPosture, SceneRenderer
from hexctl.vision.detection.planar_pose import PlacedTag
from hexctl.vision.detection.tags import Picture

#: Maximum number of pictures in flight; a faster camera waits.
MOST_WAITING = 8

#: Quality of the JPEGs, as webcams have it.
QUALITY = 85

#: The posture at a moment is known once the next state has come: a control period and what the link takes.
SETTLE_S = 0.023

#: Longest wait between two questions whether to stop.
POLL_S = 0.05

#: When the frame rate is checked, and the share of the requested rate below which a warning is printed.
JUDGED_AFTER_S, LEAST_SHARE = 5.0, 0.9

#: Time without a true pose after which the robot counts as silent.
SILENT_S = 1.0


@dataclass(frozen=True, slots=True)
class PictureFlow:
    """How pictures come: per second, how late, the lost fraction, faults as texts, and the seed."""

    fps: float
    latency_ms: float
    drop: float
    faults: tuple[str, ...]
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinReport:
    """Statistics of a rendered camera.

    Attributes:
        duration_s: total time.
        drawn: number of rendered pictures.
        delivered: number of delivered pictures.
        dropped: number of pictures dropped on request.
        skipped: number of pictures skipped for lack of time.
        late: number of pictures delivered too late.
        latency_s: mean time from exposure to delivery; None without delivery.
        drawing_s: recent time to render a picture.
        developing_s: recent time to process and encode a picture.
    """

    duration_s: float
    drawn: int
    delivered: int
    dropped: int
    skipped: int
    late: int
    latency_s: float | None
    drawing_s: float
    developing_s: float

    @property
    def fps(self) -> float:
        """Pictures drawn per second."""
        return self.drawn / self.duration_s if self.duration_s > 0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON values, rounded."""
        return {
            "duration_s": round(self.duration_s, 1),
            "fps": round(self.fps, 1),
            "drawn": self.drawn,
            "delivered": self.delivered,
            "dropped": self.dropped,
            "skipped": self.skipped,
            "late": self.late,
            "latency_ms": None if self.latency_s is None else round(1000 * self.latency_s, 1),
            "drawing_ms": round(1000 * self.drawing_s, 1),
            "developing_ms": round(1000 * self.developing_s, 1),
        }


class Delivery:
    """Process and encode pictures on a thread and deliver each at its due time; must be closed.

    Attributes:
        delivered: number of delivered pictures.
        late: number of pictures delivered more than `LATE_S` too late.
        latency_s: sum of the times from exposure to delivery.
        developing_s: recent time to process and encode a picture.
    """

    #: A picture that arrives later than this after it is due is late.
    LATE_S = 0.005

    def __init__(self, publish: Callable[[bytes], None]) -> None:
        """Begin to wait; `publish` is called on the thread with each JPEG."""
        self._publish = publish
        self.delivered, self.late, self.latency_s, self.developing_s = 0, 0, 0.0, 0.02
        self._waiting: Queue[tuple[Callable[[], Picture], float, float] | None] = Queue(MOST_WAITING)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="delivery", daemon=True)
        self._thread.start()

    def send(self, develop: Callable[[], Picture], taken_at_s: float, due_at_s: float) -> None:
        """Put a picture on its way, after those before it; times are on time.monotonic.

        `develop` gives the picture (H, W, 3), blue first, on the thread of the delivery.
        """
        self._waiting.put((develop, taken_at_s, due_at_s))

    def close(self) -> None:
        """End the thread; pictures in flight are lost."""
        self._over.set()
        self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (taken := self._waiting.get()) is not None:
            if not self._over.is_set():
                self._deliver(*taken)

    def _deliver(self, develop: Callable[[], Picture], taken_at_s: float, due_at_s: float) -> None:
        began_s = time.monotonic()
        jpeg = cv2.imencode(".jpg", develop(), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
        done_s = time.monotonic()
        self.developing_s += 0.2 * (done_s - began_s - self.developing_s)
        if self._over.wait(max(0.0, due_at_s - done_s)):
            return
        self._publish(jpeg)
        now_s = time.monotonic()
        self.delivered += 1
        self.latency_s += now_s - taken_at_s
        self.late += now_s - due_at_s > self.LATE_S


class Shooting:
    """Takes pictures at a constant rate, or as often as the computer manages in time."""

    def __init__(
        self,
        flow: PictureFlow,
        renderer: SceneRenderer,
        robot_tag: PlacedTag,
        history: PostureHistory,
        on_event: Callable[[str], None],
    ) -> None:
        self._flow, self._history, self._on_event = flow, history, on_event
        self._still, self._renderer, self._tag = renderer.camera, renderer, robot_tag
        self._faults = tuple(map(parse_camera_fault, flow.faults))
        self._random = np.random.default_rng(flow.seed)
        self._drawing_s = 0.03
        self._drawn = self._dropped = self._skipped = 0
        self._silent = self._told = False

    def run(self, stop_requested: Callable[[], bool], publish: Callable[[bytes], None]) -> TwinReport:
        """Take pictures until a stop is requested, and publish each as a JPEG."""
        delivery = Delivery(publish)
        started_s = time.monotonic()
        try:
            self._shoot(stop_requested, started_s, delivery)
        finally:
            delivery.close()
        return TwinReport(
            duration_s=time.monotonic() - started_s,
            drawn=self._drawn,
            delivered=delivery.delivered,
            dropped=self._dropped,
            skipped=self._skipped,
            late=delivery.late,
            latency_s=delivery.latency_s / delivery.delivered if delivery.delivered else None,
            drawing_s=self._drawing_s,
            developing_s=delivery.developing_s,
        )

    def _shoot(self, stop_requested: Callable[[], bool], started_s: float, delivery: Delivery) -> None:
        period_s, number = 1 / self._flow.fps, 0
        while not stop_requested():
            now_s = time.monotonic()
            self._judge(now_s, now_s - started_s, delivery)
            newest = int((now_s - SETTLE_S - started_s) / period_s)
            known_s = started_s + number * period_s + SETTLE_S
            if newest < number or now_s < known_s:
                time.sleep(min(POLL_S, max(0.0, known_s - now_s) + 1e-4))
                continue
            taken_at_s = started_s + newest * period_s
            self._skipped += newest - number
            number = newest + 1
            due_at_s = taken_at_s + max(self._flow.latency_ms / 1000, SETTLE_S + self._cost_s(delivery))
            if now_s + self._cost_s(delivery) > due_at_s + Delivery.LATE_S:
                self._skipped += 1  # the next moment can be drawn in time
                continue
            posture = self._history.at(taken_at_s)
            if posture is None:
                raise AssertionError("a posture was waited for")
            develop = self._take(posture, taken_at_s - started_s)
            self._drawn += 1
            self._drawing_s += 0.2 * (time.monotonic() - now_s - self._drawing_s)
            if self._random.random() < self._flow.drop:
                self._dropped += 1
            else:
                delivery.send(develop, taken_at_s, due_at_s)

    def _take(self, posture: RobotPosture, at_s: float) -> Callable[[], Picture]:
        """Take a picture at a time since the start; return a function that processes it to (H, W, 3), BGR."""
        camera = faulty_camera(self._still, self._faults, at_s)
        if camera != self._renderer.camera:
            self._renderer.move_camera(camera)
        exposed = self._renderer.expose(posture)

        def develop() -> Picture:
            picture = self._renderer.develop(exposed, at_s)
            if is_covered(self._faults, at_s):
                picture = with_hand(picture, camera, posture, self._tag)
            return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))

        return develop

    def _cost_s(self, delivery: Delivery) -> float:
        return self._drawing_s + delivery.developing_s

    def _judge(self, now_s: float, since_start_s: float, delivery: Delivery) -> None:
        """Report when the robot falls silent, and once if the computer is too slow."""
        silent = now_s - (self._history.newest_at_s or now_s) > SILENT_S
        if silent != self._silent:
            self._silent = silent
            self._on_event(
                "the robot is silent; the picture shows its last pose" if silent else "the robot is back"
            )
        if self._told or since_start_s < JUDGED_AFTER_S:
            return
        self._told = True
        managed_fps = self._drawn / since_start_s
        least_ms = 1000 * (SETTLE_S + self._cost_s(delivery))
        if managed_fps < LEAST_SHARE * self._flow.fps:
            self._on_event(
                f"this computer draws {managed_fps:.1f} of {self._flow.fps:g} pictures a second in time"
            )
        if least_ms > self._flow.latency_ms + 1000 * Delivery.LATE_S:
            self._on_event(f"pictures are {least_ms:.0f} ms late, as drawing takes that long")
