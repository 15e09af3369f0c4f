"""`--arena` of `hexctl adapt`: a radius, or the place that a camera sees."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.cli.see.arena_command import arena_fields, arena_of
from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.detection.camera import Camera
from hexctl.vision.place import CameraPose, load_place
from hexctl.vision.place import arena_of as seen_arena
from tests.vision.scenes import WEBCAM
from tests.vision.test_place import PLACE, saved


def test_a_number_is_a_radius_and_anything_else_a_file() -> None:
    assert arena_of("2") == 2.0
    assert arena_of("place.yaml") == Path("place.yaml")
    assert arena_of(Path("place.yaml")) == Path("place.yaml")
    for text in ("0", "nan", "-1"):
        with pytest.raises(ValueError, match="above 0"):
            arena_of(text)
    with pytest.raises(ValueError, match=r"got 'wide'; allowed: a number, .* or a file of hexctl see"):
        arena_of("wide")


@pytest.mark.slow
def test_a_place_file_gives_the_circle_that_its_camera_sees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = saved(tmp_path)
    (x_m, y_m), radius_m = seen_arena(load_place(path), load_robot("ant"))
    fields = arena_fields(path, None)
    assert fields["home_m"] == pytest.approx([x_m, y_m], abs=0.001)
    assert radius_m - 0.01 < fields["arena_m"] <= radius_m
    assert f"kept within {fields['arena_m']:g} m of {x_m:.2f}, {y_m:.2f} m" in capsys.readouterr().err


def test_a_radius_needs_no_camera() -> None:
    assert arena_fields(None, "ant") == {}
    assert arena_fields(2.0, "ant") == {"arena_m": 2.0}


def test_places_that_give_no_arena_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"place\.yaml"):
        arena_fields(tmp_path / "place.yaml", "ant")
    up = Camera.looking(WEBCAM, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.9]))
    saved(tmp_path, replace(PLACE, camera=CameraPose.of(up))).rename(tmp_path / "up.yaml")
    with pytest.raises(InputError, match="nowhere on the floor"):
        arena_fields(tmp_path / "up.yaml", "ant")
