from typing import get_args

import pytest

from hexctl.errors import InputError
from hexctl.export.export_options import Camera, ExportOptions, PictureOptions
from hexctl.export.render import CAMERAS


def test_cameras_are_those_of_a_scene() -> None:
    assert get_args(Camera) == CAMERAS


def test_only_options_of_pictures_that_were_given_count() -> None:
    assert ExportOptions(to="csv", output="x").given == {}
    assert PictureOptions(from_s=0.0, captions=["a"]).given == {"from_s": 0.0, "captions": ("a",)}


def test_another_format_is_refused() -> None:
    with pytest.raises(InputError, match="to: got xlsx; allowed: urdf, mjcf, mcap"):
        ExportOptions(to="xlsx")  # type: ignore[arg-type]
