"""`hexctl see latency`: bad input; tests/vision/test_latency_trial.py measures with it."""

from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from tests.server.processes import free_port
from tests.vision.test_place import saved


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--camera: got none; allowed: a number such as 0"),
        (["--camera", "0"], "--place: place.yaml is not there; allowed: a place that hexctl see --camera"),
        (["--camera", "0", "--fps", "0"], "--fps: got 0; allowed: 1 to 60 Hz"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_code(["see", "latency", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_a_camera_that_is_not_there_is_a_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place, url = saved(tmp_path), f"http://127.0.0.1:{free_port()}/"
    assert exit_code(["see", "latency", "--camera", url, "--place", str(place)]) == 3
    assert "no video comes from" in capsys.readouterr().err
