"""Pictures on their way from a camera: developed, encoded, and each as late as it should be."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from queue import Queue

import cv2

from hexctl.vision.detection.tags import Picture

#: Maximum number of pictures in flight; a faster camera waits.
MOST_WAITING = 8

#: Quality of the JPEGs, as webcams have it.
QUALITY = 85


@dataclass(frozen=True, slots=True, eq=False)
class TakenPicture:
    """A picture on its way.

    Attributes:
        develop: gives the picture (H, W, 3), blue first; called on the thread of the delivery.
        taken_at_s: when the camera saw it, on time.monotonic.
        due_at_s: when it is to arrive.
    """

    develop: Callable[[], Picture]
    taken_at_s: float
    due_at_s: float


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
        """Begin to wait.

        Args:
            publish: called on the thread with each JPEG.
        """
        self._publish = publish
        self.delivered, self.late, self.latency_s, self.developing_s = 0, 0, 0.0, 0.02
        self._waiting: Queue[TakenPicture | None] = Queue(MOST_WAITING)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="delivery", daemon=True)
        self._thread.start()

    def send(self, taken: TakenPicture) -> None:
        """Put a picture on its way, after those before it."""
        self._waiting.put(taken)

    def close(self) -> None:
        """End the thread; pictures in flight are lost."""
        self._over.set()
        self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (taken := self._waiting.get()) is not None:
            if not self._over.is_set():
                self._deliver(taken)

    def _deliver(self, taken: TakenPicture) -> None:
        began_s = time.monotonic()
        jpeg = cv2.imencode(".jpg", taken.develop(), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
        done_s = time.monotonic()
        self.developing_s += 0.2 * (done_s - began_s - self.developing_s)
        if self._over.wait(max(0.0, taken.due_at_s - done_s)):
            return
        self._publish(jpeg)
        now_s = time.monotonic()
        self.delivered += 1
        self.latency_s += now_s - taken.taken_at_s
        self.late += now_s - taken.due_at_s > self.LATE_S
