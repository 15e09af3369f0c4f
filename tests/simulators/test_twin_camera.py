"""A rendered camera: its pictures, faults, delivery, and the robot that it follows."""

import math
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.simulators.camera import posture_history
from hexctl.simulators.camera.camera_faults import faulty_camera, is_covered, parse_camera_fault, with_hand
from hexctl.simulators.camera.posture_history import KEPT, PostureHistory, followed_robot
from hexctl.simulators.camera.shooting import Delivery, TwinReport
from hexctl.simulators.camera.twin_camera import TwinCamera, TwinStarted, parse_point
from hexctl.types import FloatArray
from hexctl.vision.detection.planar_pose import PlanarPose, tag_pose
from hexctl.vision.detection.tags import SeenTag, TagFinder
from hexctl.vision.video.videos import VideoSource, open_video
from hexctl.waiting import wait_for
from hexctl.wire.links import Link
from tests.server.processes import served
from tests.vision.scenes import CAMERA, FLOOR_TAGS, ROBOT_TAG, plain, scene, standing, tag_on


def test_a_camera_stands_still_until_it_is_moved_and_turned() -> None:
    faults = [parse_camera_fault("moved:0.1,0,0.2@5"), parse_camera_fault("turned:90@6")]
    assert faulty_camera(CAMERA, faults, 4.9) == CAMERA
    moved = faulty_camera(CAMERA, faults, 5.0)
    assert np.allclose(moved.position_floor, CAMERA.position_floor + np.array([0.1, 0, 0.2]))
    assert (moved.rotation == CAMERA.rotation).all()
    turned = faulty_camera(CAMERA, faults, 6.0)
    covered = [parse_camera_fault("covered:2@3")]
    assert [is_covered(covered, at_s) for at_s in (2.9, 3.0, 4.9, 5.0)] == [False, True, True, False]
    assert np.allclose(CAMERA.rotation[:2, 2] @ turned.rotation[:2, 2], 0)
    assert turned.rotation[1, 2] > 0  # from ahead to the left
    assert turned.rotation[2, 2] == pytest.approx(CAMERA.rotation[2, 2])


@pytest.mark.slow
def test_a_covered_tag_is_not_seen_and_the_others_are() -> None:
    robot = load_robot("ant")
    posture = standing(robot, PlanarPose(0.2, -0.1, 0.5))
    with scene() as renderer:
        picture = renderer.draw_color(posture)
        covered = with_hand(picture, CAMERA, posture, tag_on(robot))
    finder = TagFinder()
    assert ROBOT_TAG in finder.search(picture[..., 1].copy(), thorough=True)
    assert set(finder.search(covered[..., 1].copy(), thorough=True)) == set(FLOOR_TAGS)


def brightness(jpeg: bytes) -> int:
    import cv2

    return round(
        float(np.mean(np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE))))
    )


def test_pictures_arrive_in_order_and_none_before_it_is_due() -> None:
    arrived: list[tuple[int, float]] = []
    delivery = Delivery(lambda jpeg: arrived.append((brightness(jpeg), time.monotonic())))
    began_s = time.monotonic()
    due_s = [began_s + 0.1 + 0.02 * number for number in range(8)]
    for number, due_at_s in enumerate(due_s):
        delivery.send(partial(plain, 10 * number), began_s, due_at_s)
    wait_for(lambda: len(arrived) == 8, 10, "not all pictures arrived")
    delivery.send(lambda: plain(0), 0.0, time.monotonic() + 3600)
    delivery.close()
    assert [bright for bright, _ in arrived] == [10 * number for number in range(8)]
    assert all(at_s >= due_at_s for (_, at_s), due_at_s in zip(arrived, due_s, strict=True))
    assert delivery.delivered == 8
    assert delivery.latency_s >= sum(due_s) - 8 * began_s


JOINTS = np.arange(18.0)


def turned(yaw_rad: float) -> FloatArray:
    return np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])


def test_between_two_states_it_is_between_them() -> None:
    history = PostureHistory()
    history.add_joints(1.0, JOINTS)
    history.add_joints(1.02, JOINTS + 0.2)
    history.add_truth(1.0, np.array([0.0, 1.0, 0.1]), turned(0.1))
    history.add_truth(1.02, np.array([0.1, 1.0, 0.1]), -turned(0.2))  # the same orientation as turned(0.2)
    posture = history.at(1.005)
    assert posture is not None
    assert posture.position_floor == pytest.approx([0.025, 1.0, 0.1])
    assert posture.quaternion_floor == pytest.approx(turned(0.125), abs=1e-5)
    assert posture.joint_positions_rad == pytest.approx(JOINTS + 0.05)


def test_before_and_after_all_states_it_is_the_nearest() -> None:
    history = PostureHistory()
    for number in range(KEPT + 50):
        history.add_joints(number / 50, JOINTS)
        history.add_truth(number / 50, np.array([number, 0.0, 0.1]), turned(0))
    early, late = history.at(0.0), history.at(1e6)
    assert PostureHistory().at(1.0) is None
    assert early is not None
    assert late is not None
    assert (early.position_floor[0], late.position_floor[0]) == (50, KEPT + 49)
    assert history.newest_at_s == (KEPT + 49) / 50


@pytest.mark.realtime
def test_a_robot_that_is_not_simulated_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posture_history, "FIRST_TRUTH_S", 0.5)
    with (
        served(tmp_path, backend="mock") as robot,
        pytest.raises(RobotFaultError, match="ant"),
        followed_robot(Link(endpoint=robot.endpoint)),
    ):
        pass


def tags(source: VideoSource) -> dict[int, SeenTag]:
    """Tags in the next picture; none without a picture."""
    frame = source.read(10)
    return {} if frame is None else TagFinder().search(frame.gray(), thorough=True)


@pytest.mark.realtime
def test_it_shows_a_served_robot_where_it_truly_is_and_says_when_it_falls_silent(tmp_path: Path) -> None:
    started: list[TwinStarted] = []
    reports: list[TwinReport] = []
    said: list[str] = []
    over = threading.Event()

    def run(connect: str) -> None:
        twin = TwinCamera(fps=10, connect=connect, robot="ant")
        reports.append(twin.run(over.is_set, on_started=started.append, on_event=said.append))

    with served(tmp_path, backend="sim") as robot:
        thread = threading.Thread(target=run, args=(robot.endpoint,))
        thread.start()
        try:
            wait_for(lambda: started, 30, "the camera never began")
            with (
                followed_robot(Link(endpoint=robot.endpoint)) as (model, history),
                open_video(started[0].url) as source,
            ):
                found = wait_for(
                    lambda: seen if {*FLOOR_TAGS, ROBOT_TAG} == set(seen := tags(source)) else None,
                    30,
                    "not all tags were seen",
                )
                truth = history.at(history.newest_at_s or 0.0)
            port = int(started[0].url.split(":")[2].split("/")[0])
            with pytest.raises(RobotFaultError, match=f"http_port: got {port}"):
                TwinCamera(connect=robot.endpoint, http_port=port).run(over.is_set)
            robot.end()
            wait_for(lambda: said, 10, "the silence was never told")
        finally:
            over.set()
            thread.join()
    assert truth is not None
    height_m = float(truth.position_floor[2]) + tag_on(model).height_m
    seen = tag_pose(CAMERA, found[ROBOT_TAG].corners_px, height_m)
    assert seen is not None
    assert (seen.pose.x_m, seen.pose.y_m) == pytest.approx(truth.position_floor[:2], abs=0.005)
    assert abs(wrapped_rad(seen.pose.yaw_rad - float(yaw_rad(truth.quaternion_floor)))) < 0.02
    (report,) = reports
    assert report.latency_s is not None
    assert report.latency_s >= 0.0799
    assert report.drawn >= report.delivered + report.dropped > 0


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("fps", 0.5),
        ("drop", 1.5),
        ("size_px", (10, 10)),
        ("position_m", (0.0, 0.0, 0.0)),
        *[
            ("faults", (text,))
            for text in ("", "moved", "moved:1,2", "moved:1,2,3@", "turned:nan", "fogged:1")
        ],
        *[("faults", (text,)) for text in ("covered:0@1", "covered:2@-1")],
    ],
)
def test_an_option_that_is_not_allowed_is_refused_by_name(option: str, value: object) -> None:
    with pytest.raises(InputError, match=option.removesuffix("s")):
        TwinCamera(**{option: value})  # type: ignore[arg-type]


def test_a_point_is_three_numbers() -> None:
    assert parse_point("-1.63,0,1.63") == (-1.63, 0.0, 1.63)
    for text in ("1,2", "1,2,3,4", "x,y,z", "nan,0,1", "1000,0,1", ""):
        with pytest.raises(ValueError, match="X,Y,Z"):
            parse_point(text)
