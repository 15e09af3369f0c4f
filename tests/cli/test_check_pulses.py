"""`hexctl check` on servo maps."""

import json
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from tests.backends.mavlink.boards import fitting_file


@pytest.mark.parametrize(
    ("offset_deg", "beyond", "gait_fits", "words"),
    [
        (75, 0, True, "servos: every range fits into the pulse limits"),
        (60, 6, True, "a board clips it, this gait is not"),
        (0, 6, False, "a board clips it, this gait too"),
    ],
)
def test_whether_ranges_and_gait_fit_into_the_pulses(
    offset_deg: float,
    beyond: int,
    gait_fits: bool,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = str(fitting_file(tmp_path, {"tibia": {"offset_deg": offset_deg}}))
    assert exit_code(["check", path, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert len(report["joints_beyond_pulses"]) == beyond
    assert report["gait_fits_pulses"] == gait_fits
    assert len(report["pulses_us"]) == 18
    assert exit_code(["check", path]) == 0
    assert words in capsys.readouterr().out


def test_a_bad_servo_map_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(fitting_file(tmp_path, {"leg1_coxa": {"channel": 2}}))
    assert exit_code(["check", path]) == 2
    assert "channel 2 for leg1_coxa and leg1_femur" in capsys.readouterr().err
