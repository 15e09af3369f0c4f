"""The secret of the datagram stop: made with the certificates, for ends that may stop, and kept private."""

import os
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import Link, Role
from hexctl.wire.stop_secret import NO_SECRET, SECRET_FILE, find_stop_secret, write_stop_secret


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_certificates(tmp_path / "keys", hosts=["localhost"], days=1)
    return tmp_path / "keys"


def test_robot_and_controller_share_it_and_viewers_have_none(folder: Path) -> None:
    link = Link(endpoint="tls/localhost:7447", credentials=folder)
    secret = find_stop_secret(link, Role.ROBOT)
    assert secret is not None
    assert len(secret) == 32
    assert find_stop_secret(link, Role.CONTROLLER) == secret
    part = Link(endpoint="tls/localhost:7447", credentials=folder / "controller")
    assert find_stop_secret(part, Role.CONTROLLER) == secret
    assert sorted(path.parent.name for path in folder.rglob(SECRET_FILE)) == ["controller", "robot"]
    assert {path.stat().st_mode & 0o777 for path in folder.rglob(SECRET_FILE)} == {0o600}


def test_without_certificates_anybody_may_stop() -> None:
    assert find_stop_secret(Link(), Role.ROBOT) == find_stop_secret(Link(), Role.CONTROLLER) == NO_SECRET


def test_a_folder_of_before_gets_it_by_a_command_once(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in folder.rglob(SECRET_FILE):
        path.unlink()
    link = Link(endpoint="tls/localhost:7447", credentials=folder)
    assert find_stop_secret(link, Role.ROBOT) is None
    assert exit_code(["keys", "stop", str(folder)]) == 0
    assert capsys.readouterr().out.count(SECRET_FILE) == 2
    secret = find_stop_secret(link, Role.ROBOT)
    assert secret is not None
    assert exit_code(["keys", "stop", str(folder)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert find_stop_secret(link, Role.ROBOT) == secret


def test_one_part_of_a_folder_gets_none(folder: Path) -> None:
    with pytest.raises(InputError, match="whole"):
        write_stop_secret(folder / "controller")


def test_both_ends_get_it_or_none(folder: Path) -> None:
    for path in folder.rglob(SECRET_FILE):
        path.unlink()
    (folder / "controller" / SECRET_FILE).symlink_to(folder / "nowhere" / "x")
    with pytest.raises(InputError, match="cannot be written"):
        write_stop_secret(folder)
    assert not (folder / "robot" / SECRET_FILE).exists()


@pytest.mark.parametrize(
    ("content", "mode", "said"),
    [
        (b"", 0o600, "has 0 bytes"),
        (b"00" * 31, 0o600, "has 31 bytes"),
        (b"no hex", 0o600, "is not a secret"),
        (b"\xff", 0o600, "is not a secret"),
        (b"00" * 1_000_000, 0o600, "it is larger than"),
        (b"00" * 32, 0o640, "chmod 600"),
        (b"00" * 32, 0o604, "chmod 600"),
    ],
)
def test_what_is_no_secret_is_refused(folder: Path, content: bytes, mode: int, said: str) -> None:
    path = folder / "robot" / SECRET_FILE
    path.write_bytes(content)
    path.chmod(mode)
    with pytest.raises(InputError, match=said):
        find_stop_secret(Link(endpoint="tls/localhost:7447", credentials=folder), Role.ROBOT)


@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "dangling link"])
def test_what_is_no_plain_file_is_refused_and_not_taken_for_a_missing_one(folder: Path, kind: str) -> None:
    path = folder / "robot" / SECRET_FILE
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path, mode=0o600)
    elif kind == "folder":
        path.mkdir(mode=0o700)
    else:
        path.symlink_to("/dev/zero" if kind == "device" else "nothing")
    with pytest.raises(InputError, match="is not a secret"):
        find_stop_secret(Link(endpoint="tls/localhost:7447", credentials=folder), Role.ROBOT)
