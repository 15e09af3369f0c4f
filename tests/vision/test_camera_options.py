from pathlib import Path

import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.vision.camera_options import CameraOptions, LinkedRobotOptions, parse_size
from hexctl.vision.robot_camera import RobotCamera


def test_a_link_is_that_of_the_options(tmp_path: Path) -> None:
    link = LinkedRobotOptions(
        connect="tls/robot.local:7447", credentials=str(tmp_path), robot="ant"
    ).load_link()
    assert (link.endpoint, link.credentials) == ("tls/robot.local:7447", tmp_path)
    with pytest.raises(InputError, match="no-such-link"):
        LinkedRobotOptions(link="no-such-link").load_link()


def test_a_camera_is_a_number_or_a_name() -> None:
    for camera in (63, "63"):
        with pytest.raises(Exception, match="there is no camera /dev/video63"):
            CameraOptions(camera=camera).open_video()


def test_wrong_types_are_refused_by_name() -> None:
    with pytest.raises(InputError, match="camera: got none; allowed: a number such as 0"):
        CameraOptions()
    with pytest.raises(WrongTypeError, match=r"camera: got 0\.5 "):
        CameraOptions(camera=0.5)  # type: ignore[arg-type]
    with pytest.raises(WrongTypeError, match=r"place: got 5"):
        CameraOptions(camera=0, place=5)  # type: ignore[arg-type]
    with pytest.raises(WrongTypeError, match=r"robot: got 5"):
        LinkedRobotOptions(robot=5)  # type: ignore[arg-type]


def test_a_size_is_two_numbers() -> None:
    assert parse_size("1280x720") == (1280, 720)
    for text in ("1280", "x", "1280x", "-1x2", "1.5x2"):
        with pytest.raises(ValueError, match="allowed: WIDTHxHEIGHT in px"):
            parse_size(text)


@pytest.mark.parametrize(
    ("page", "host", "port"),
    [(8019, "127.0.0.1", 8019), ("0", "127.0.0.1", 0), ("localhost:8019", "localhost", 8019),
     ("[::1]:8019", "::1", 8019)],
)  # fmt: skip
def test_a_page_is_a_port_or_an_address_of_this_computer(page: int | str, host: str, port: int) -> None:
    address = RobotCamera(camera=0, page=page).page_address
    assert address is not None
    assert (address.host, address.port) == (host, port)
    assert RobotCamera(camera=0).page_address is None


@pytest.mark.parametrize("page", ["0.0.0.0:8019", "robot.local:8019", "8019:", "70000", -1])
def test_a_page_that_others_reach_or_that_is_none_is_refused(page: int | str) -> None:
    with pytest.raises(InputError, match="page: got "):
        RobotCamera(camera=0, page=page)
