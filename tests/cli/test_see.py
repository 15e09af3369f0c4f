"""`hexctl see` and `--arena`: a camera, its place, its lens, and the pose to the robot."""

import json
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.cli.shared_options import arena_fields, arena_of
from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.simulators.camera.posture_history import followed_robot
from hexctl.simulators.camera.rendering import FLOOR_TAGS, WEBCAM
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.lens import load_lens, save_lens
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.place import CameraPose, load_place
from hexctl.vision.place import arena_of as seen_arena
from hexctl.waiting import wait_for
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.pose import decode_pose
from hexctl.wire.zenoh_session import open_session
from tests.cli.conftest import Call
from tests.server.processes import free_port, hexctl_process, program, served
from tests.vision import scenes
from tests.vision.test_place import PLACE, saved

HOME = FLOOR_TAGS[0].pose


@pytest.mark.long
@pytest.mark.realtime
def test_a_robot_walks_by_the_pose_that_a_camera_sees(tmp_path: Path) -> None:
    """In the frame of the home tag, within centimetres of the truth that only the camera is told."""
    save_lens(WEBCAM, tmp_path / "lens.yaml")
    with served(tmp_path, backend="sim") as robot:
        link = ("--connect", robot.endpoint)
        twin = ("hexctl", "sim", "camera", *link, "--fps", "12", "--size", "960x540", "--latency-ms", "120")
        with program(tmp_path, "twin", *twin) as camera:
            camera.wait_for("Ctrl-C ends it")
            url = camera.said().partition(" at ")[2].split()[0]
            look = (
                "hexctl", "see", "--camera", url, *link, "--latency-ms", "120",
                "--lens", str(tmp_path / "lens.yaml"), "--place", str(tmp_path / "place.yaml"),
            )  # fmt: skip
            with program(tmp_path, "look", *look, "--json") as looking:
                looking.wait_for("seeing")
                walked = hexctl_process(
                    "run", "--backend", "zenoh", *link, "--gait", "tripod", "--duration", "6", "--no-record",
                    "--json",
                )  # fmt: skip
                assert walked.returncode == 0, walked.stderr
                _compare(robot.endpoint)
                looking.signal(signal.SIGINT)
                assert looking.wait() == 0
                report = json.loads(looking.said().strip().splitlines()[-1])
    result = json.loads(walked.stdout)
    assert result["hold"] == "line"
    assert result["distance_m"] > 0.2
    assert report["seen"] > 0.5
    assert (tmp_path / "place.yaml").exists()


def _compare(endpoint: str) -> None:
    """The robot's own pose, which is the camera's, is where it truly is on the floor of the home tag."""
    link = Link(endpoint=endpoint)
    keys, poses = KeyMap.of("ant"), []
    with followed_robot(link) as (_, history), open_session(link, Role.VIEWER, keys) as session:
        session.declare_subscriber(keys.odom, lambda sample: poses.append(bytes(sample.payload)))
        wait_for(lambda: len(poses) > 50, 30, "no poses came")
        truth = history.at(history.newest_at_s or 0.0)
    position, quaternion = decode_pose(poses[-1])
    assert truth is not None
    assert position is not None
    assert quaternion is not None
    x_m, y_m = truth.position_floor[:2].tolist()
    true = HOME.inverse().after(PlanarPose(x_m, y_m, float(yaw_rad(truth.quaternion_floor))))
    assert np.hypot(position[0] - true.x_m, position[1] - true.y_m) < 0.03
    assert abs(wrapped_rad(float(yaw_rad(quaternion)) - true.yaw_rad)) < 0.05


@pytest.mark.slow
def test_a_camera_that_is_not_there_is_a_fault(tmp_path: Path, call: Call) -> None:
    place, url = str(saved(tmp_path)), f"http://127.0.0.1:{free_port()}/"
    for words, named in (
        (["--camera", url, "--no-link"], url),
        (["--camera", "63", "--no-link"], "/dev/video63"),
        (["--camera", "63", "--no-link", "--place", place], "/dev/video63"),
    ):
        assert named in call("see", *words, code=3).err


@pytest.mark.slow
def test_the_command_takes_a_video(call: Call, tmp_path: Path) -> None:
    import cv2

    from tests.vision.test_detection_lenses import LENSES, pictures, ray_error_px

    video = tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 30, (640, 480), False)
    for picture in pictures("480p"):
        writer.write(picture)
        writer.write(picture)
    writer.release()
    output = tmp_path / "lens.yaml"
    call("see calibrate --camera", str(video), "--output", str(output))
    assert ray_error_px(LENSES["480p"], load_lens(output)) < 0.7


def test_a_number_is_a_radius_and_anything_else_a_file() -> None:
    assert arena_of("2") == 2.0
    assert arena_of("place.yaml") == Path("place.yaml")
    assert arena_of(Path("place.yaml")) == Path("place.yaml")
    for text in ("0", "nan", "-1", "wide"):
        with pytest.raises(ValueError, match=text):
            arena_of(text)


@pytest.mark.slow
def test_a_place_file_gives_the_circle_that_its_camera_sees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = saved(tmp_path)
    (x_m, y_m), radius_m = seen_arena(load_place(path), load_robot("ant"))
    fields = arena_fields(path, None)
    assert fields["home_m"] == pytest.approx([x_m, y_m], abs=0.001)
    assert radius_m - 0.01 < fields["arena_m"] <= radius_m
    assert f"{fields['arena_m']:g} m" in capsys.readouterr().err


def test_places_that_give_no_arena_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"place\.yaml"):
        arena_fields(tmp_path / "place.yaml", "ant")
    up = Camera.looking(scenes.WEBCAM, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.9]))
    saved(tmp_path, replace(PLACE, camera=CameraPose.of(up))).rename(tmp_path / "up.yaml")
    with pytest.raises(InputError, match="floor"):
        arena_fields(tmp_path / "up.yaml", "ant")
