"""`hexctl sim camera` as a user calls it."""

import json
import signal
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.vision.detection.lens import load_lens
from hexctl.vision.video.video_source import open_video
from hexctl.waiting import wait_for
from tests.server.processes import free_port, program, served

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fps", "0"], "--fps: got 0; allowed: 1 to 60 Hz"),
        (["--latency-ms", "x"], "--latency-ms: got 'x'; allowed: a number, 0 to 2000 ms"),
        (["--size", "1280"], "--size: got 1280; allowed: WIDTHxHEIGHT in px, such as 1280x720"),
        (["--size", "8x8"], "--size: got 8x8; allowed: 64 to 4096 px"),
        (["--position", "1,2"], "--position: got 1,2; allowed: X,Y,Z in m"),
        (["--position", "1,2,nan"], "--position: got 1,2,nan; allowed: X,Y,Z in m"),
        (["--position", "0,0,-1"], "--position: got (0.0, 0.0, -1.0); allowed: above the floor"),
        (["--fault", "fogged@3"], "--fault: got 'fogged@3'; allowed: moved:X,Y,Z (m)"),
        (["--lens", "no-such.yaml"], "no-such.yaml"),
        (["--drop", "2"], "--drop: got 2; allowed: 0..1"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["sim", "camera", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_without_a_robot_it_is_a_fault(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["sim", "camera", "--connect", f"tcp/127.0.0.1:{free_port()}"]) == 3
    assert "nothing listens" in capsys.readouterr().err


def test_ctrl_c_ends_it_with_what_it_managed(tmp_path: Path) -> None:
    with served(tmp_path, backend="sim") as robot:
        arguments = ("hexctl", "sim", "camera", "--connect", robot.endpoint, "--fps", "10", "--json")
        with program(tmp_path, "camera", *arguments) as camera:
            camera.wait_for("Ctrl-C ends it")
            url = camera.said().partition(" at ")[2].split()[0]
            camera.wait_for("--lens ")
            lens_file = camera.said().partition("--lens ")[2].split()[0]
            assert load_lens(Path(lens_file)).calibrated
            with open_video(url) as source:
                wait_for(source.read, 30, "no picture came")
            camera.signal(signal.SIGINT)
            assert camera.wait() == 0
            report = json.loads(camera.said().strip().splitlines()[-1])
    assert report["delivered"] > 0
