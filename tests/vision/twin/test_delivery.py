"""Pictures on their way."""

import time
from functools import partial

import cv2
import numpy as np

from hexctl.vision.twin.delivery import Delivery, TakenPicture
from hexctl.waiting import wait_for
from tests.vision.feeding import plain


def brightness(jpeg: bytes) -> int:
    return round(
        float(np.mean(np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE))))
    )


def test_pictures_arrive_in_order_and_none_before_it_is_due() -> None:
    arrived: list[tuple[int, float]] = []
    delivery = Delivery(lambda jpeg: arrived.append((brightness(jpeg), time.monotonic())))
    began_s = time.monotonic()
    due_s = [began_s + 0.1 + 0.02 * number for number in range(20)]
    for number, due_at_s in enumerate(due_s):
        delivery.send(TakenPicture(partial(plain, 10 * number), began_s, due_at_s))
    wait_for(lambda: len(arrived) == 20, 10, "not all pictures arrived")
    delivery.close()
    assert [bright for bright, _ in arrived] == [10 * number for number in range(20)]
    assert all(at_s >= due_at_s for (_, at_s), due_at_s in zip(arrived, due_s, strict=True))
    assert delivery.delivered == 20
    assert delivery.latency_s >= sum(due_s) - 20 * began_s


def test_a_picture_that_takes_too_long_is_late() -> None:
    arrived: list[bytes] = []
    delivery = Delivery(arrived.append)
    now_s = time.monotonic()
    delivery.send(TakenPicture(lambda: plain(0), now_s - 1, now_s - 0.5))
    wait_for(lambda: arrived, 10, "no picture arrived")
    delivery.close()
    assert delivery.late == 1


def test_what_is_on_its_way_at_the_end_is_lost() -> None:
    arrived: list[bytes] = []
    delivery = Delivery(arrived.append)
    delivery.send(TakenPicture(lambda: plain(0), 0.0, time.monotonic() + 3600))
    delivery.close()
    assert arrived == []
