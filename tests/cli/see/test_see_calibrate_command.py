"""`hexctl see calibrate` as a user calls it, with pictures and with a video of the board."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hexctl.cli.main import exit_code
from hexctl.vision.detection.lens import load_lens
from tests.vision.detection.test_lens_calibration import LENSES, pictures, ray_error_px


@pytest.mark.slow
def test_the_command_writes_a_lens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = []
    for number, picture in enumerate(pictures("480p")):
        files.append(tmp_path / f"board{number}.png")
        cv2.imwrite(str(files[-1]), picture)
    blank = tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.full((480, 640), 128, dtype=np.uint8))
    output = tmp_path / "lens.yaml"
    asked = ["see", "calibrate", *map(str, [blank, *files]), "--output", str(output)]
    assert exit_code([*asked, "--json"]) == 0
    said = capsys.readouterr()
    result = json.loads(said.out)
    assert result["pictures"] >= 15
    assert result["missing"] == []
    assert "blank.png is left out: no board" in said.err
    assert ray_error_px(LENSES["480p"], load_lens(output)) < 0.5
    assert exit_code(asked) == 2
    assert "--output" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_takes_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    video = tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 30, (640, 480), False)
    for picture in pictures("480p"):
        writer.write(picture)
        writer.write(picture)
    writer.release()
    output = tmp_path / "lens.yaml"
    assert exit_code(["see", "calibrate", "--camera", str(video), "--output", str(output)]) == 0
    said = capsys.readouterr()
    assert "that is enough" in said.err
    assert "rays by about" in said.out
    assert ray_error_px(LENSES["480p"], load_lens(output)) < 0.7


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "pictures, or --camera"),
        (["a.png", "--camera", "0"], "pictures, or --camera"),
        (["nowhere.png"], "nowhere.png: is no picture"),
        (["nowhere.png", "--output", "none/lens.yaml"], "--output: got none/lens.yaml; allowed: a folder"),
    ],
)
def test_bad_input_is_said(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert exit_code(["see", "calibrate", *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
