"""`hexctl see --camera` as a user calls it: a served robot, a rendered camera, and the pose to the robot."""

import json
import math
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.cli.main import exit_code
from hexctl.cli.see.see_command import status_line
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.vision.detection.lens import save_lens
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.pose_stream import CameraStatus
from hexctl.vision.twin.posture_history import followed_robot
from hexctl.vision.twin.twin_camera import FLOOR_TAGS, WEBCAM
from hexctl.vision.video.mjpeg import MjpegServer
from hexctl.vision.video.video_writer import VideoWriter
from hexctl.waiting import wait_for
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.pose import decode_pose
from hexctl.wire.zenoh_session import open_session
from tests.server.processes import free_port, hexctl_process, program, served
from tests.vision.test_place import saved

HOME = FLOOR_TAGS[0].pose


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--camera: got none; allowed: a number such as 0"),
        (["--camera", "no-such.mp4", "--no-link"], "--camera: got 'no-such.mp4', which is not there"),
        (["--camera", "ftp://x", "--no-link"], "--camera: got 'ftp://x'; allowed: a number such as 0"),
        (["--camera", "0", "--latency-ms", "-1"], "--latency-ms: got -1; allowed: 0 to 2000 ms"),
        (["--camera", "0", "--bar-mm", "10"], "--bar-mm: got 10; allowed: 50 to 200 mm"),
        (["--camera", "0", "--fov-deg", "x"], "--fov-deg: got 'x'; allowed: a number, 10 to 150 deg"),
        (["--camera", "0", "--size", "8"], "--size: got 8; allowed: WIDTHxHEIGHT in px"),
        (["--camera", "0", "--page", "0.0.0.0:8019"], "--page: got 0.0.0.0, which other computers reach"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["see", *(arguments or ["--no-link"])]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--robot-tag", "11"], "--robot-tag: got 11, and {place} has 10; allowed: what it has, --relearn"),
        (["--robot-edge-mm", "90"], "--robot-edge-mm: got 90, and {place} has 100; allowed: what it has"),
        (["--fov-deg", "70"], "--fov-deg: got 70, and {place} has none; allowed: what it has, --relearn, or"),
        (["--lens", "other.yaml"], "--lens: got other.yaml, and {place} has"),
        (["--tag-height-mm", "40"], "--tag-height-mm: got 40, and {place} has 30; allowed: what it has"),
    ],
)
def test_what_contradicts_a_known_place_is_one_line(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = saved(tmp_path)
    assert exit_code(["see", "--camera", "63", "--no-link", "--place", str(place), *arguments]) == 2
    err = capsys.readouterr().err
    assert message.format(place=place) in err
    assert err.count("\n") == 1
    # What is not typed is what the place has: only the camera is missing.
    assert exit_code(["see", "--camera", "63", "--no-link", "--place", str(place)]) == 3


@pytest.mark.realtime
def test_a_setting_of_the_sheet_counts_as_if_typed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    saved(tmp_path)
    Path("hexctl.toml").write_text("[see]\nrobot-tag = 11\n")
    assert exit_code(["see", "--camera", "63", "--no-link"]) == 2
    assert "hexctl.toml: see.robot-tag: got 11, and place.yaml has 10; " in capsys.readouterr().err


@pytest.mark.realtime
def test_the_line_of_a_second_says_what_is_known() -> None:
    lost = PoseEstimate(at_s=1.0, sight="lost", pose=None, covariance=None, age_s=math.inf, restarts=0)
    known = replace(lost, sight="bridging", pose=PlanarPose(1.0, -2.0, 0.5), covariance=np.eye(3))
    status = CameraStatus(estimate=known, fps=12.0, seen=0.5, quality=0.91, tag_px=27.2)
    assert status_line(status) == (
        "+1.000, -2.000 m, +28.6 deg; bridging; 12 pictures a second, tag in 50%, 27 px, quality 0.91"
    )
    assert status_line(replace(status, estimate=lost)).startswith("pose not known; 12 pictures a second, tag")
    assert status_line(replace(status, seen=0.0)).endswith("tag in 0%")


@pytest.mark.realtime
def test_a_page_on_a_port_in_use_names_its_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with VideoWriter(tmp_path / "empty.avi") as writer, MjpegServer() as server:
        writer.write(np.zeros((48, 64, 3), dtype=np.uint8), 0.0)
        writer.close()
        port = server.url.rpartition(":")[2].partition("/")[0]
        asked = ["see", "--camera", str(tmp_path / "empty.avi"), "--no-link", "--page", port]
        assert exit_code(asked) == 3
    assert f"--page: got {port}, which cannot be used" in capsys.readouterr().err


@pytest.mark.realtime
def test_a_camera_that_is_not_there_is_a_fault(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["see", "--camera", f"http://127.0.0.1:{free_port()}/", "--no-link"]) == 3
    assert "no video comes from" in capsys.readouterr().err
    assert exit_code(["see", "--camera", "63", "--no-link"]) == 3
    assert "there is no camera /dev/video63" in capsys.readouterr().err


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
