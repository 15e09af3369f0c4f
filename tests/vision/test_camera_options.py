from pathlib import Path

import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.vision.camera_options import CameraOptions, LinkOptions


def test_a_link_is_that_of_the_options(tmp_path: Path) -> None:
    link = LinkOptions(connect="tls/robot.local:7447", credentials=str(tmp_path), robot="ant").load_link()
    assert (link.endpoint, link.credentials) == ("tls/robot.local:7447", tmp_path)
    with pytest.raises(InputError, match="no-such-link"):
        LinkOptions(link="no-such-link").load_link()


def test_a_camera_is_a_number_or_a_name() -> None:
    for camera in (63, "63"):
        with pytest.raises(Exception, match="there is no camera /dev/video63"):
            CameraOptions(camera=camera).open_video()


def test_wrong_types_are_refused_by_name() -> None:
    with pytest.raises(WrongTypeError, match=r"camera: got None .*; allowed: a number, a device"):
        CameraOptions(camera=None)  # type: ignore[arg-type]
    with pytest.raises(WrongTypeError, match=r"place: got 5"):
        CameraOptions(camera=0, place=5)  # type: ignore[arg-type]
    with pytest.raises(WrongTypeError, match=r"robot: got 5"):
        LinkOptions(robot=5)  # type: ignore[arg-type]
