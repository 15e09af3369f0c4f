"""The `mavlink` entry of the table of backends."""

from pathlib import Path

import pytest

from hexctl.backends.mavlink.servos import MavlinkServos
from hexctl.backends.table import BackendOptions, make_servos
from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from tests.backends.mavlink.boards import fitting_file
from tests.robots import shipped


def made(**options: object) -> MavlinkServos:
    servos = make_servos("mavlink", BackendOptions(robot=shipped(), **options))  # type: ignore[arg-type]
    assert isinstance(servos, MavlinkServos)
    return servos


def test_it_looks_for_a_board_on_this_computer_unless_told_otherwise() -> None:
    assert made()._port_text == "udpout:127.0.0.1:14550"
    assert made(connect="/dev/ttyACM0:57600")._address.number == 57600


def test_the_servo_map_comes_from_the_robot_file(tmp_path: Path) -> None:
    path = fitting_file(tmp_path, {"leg1_coxa": {"sign": -1}})
    assert made(robot_file=str(path)).servo_map.signs[0] == -1


def test_the_key_comes_from_the_folder_of_keys(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"mavlink\.key: cannot be read .*; allowed: a file of 32 random"):
        made(credentials=tmp_path)
    key = tmp_path / "mavlink.key"
    key.write_text("too short")
    with pytest.raises(InputError, match=r"mavlink\.key: got 9 bytes; allowed: 32 bytes, or 64 hexadecimal"):
        made(credentials=tmp_path)
    for content in (bytes(range(32)), bytes(range(32)).hex().encode() + b"\n"):
        key.write_bytes(content)
        assert made(credentials=tmp_path)._signing_key == bytes(range(32))


def test_the_command_makes_a_key_that_is_read_and_never_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    assert exit_code(["keys", "mavlink", str(folder)]) == 0
    content = (folder / "mavlink.key").read_bytes()
    assert (folder / "mavlink.key").stat().st_mode & 0o077 == 0
    assert made(credentials=folder)._signing_key == bytes.fromhex(content.decode())
    assert exit_code(["keys", "mavlink", str(folder)]) == 2
    assert (folder / "mavlink.key").read_bytes() == content


def test_an_unsigned_port_that_others_reach_must_be_asked_for(tmp_path: Path) -> None:
    far = "udpout:192.168.1.9:14550"
    with pytest.raises(InputError, match=r"anybody on the network could move the servos"):
        made(connect=far)
    assert made(connect=far, insecure=True)._port_text == far
    (tmp_path / "mavlink.key").write_bytes(bytes(32))
    assert made(connect=far, credentials=tmp_path)._port_text == far
