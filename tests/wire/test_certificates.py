"""Certificates and the secret of the datagram stop: made together, private, and checked before a link."""

import os
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from hexctl.wire import certificates
from hexctl.wire.certificates import (
    AUTHORITY_FILE,
    CERTIFICATE_FILE,
    find_credentials,
    hosts_of,
    load_certificate,
    make_certificates,
    renew_certificates,
)
from hexctl.wire.links import Link, Role
from hexctl.wire.stop_datagram import NO_SECRET, SECRET_FILE, find_stop_secret, write_stop_secret


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "keys"
    make_certificates(folder, hosts=["robot.local", "192.168.1.20", "::1"], days=10)
    return folder


def test_every_role_finds_its_own_in_the_common_folder_or_in_its_part_of_it(folder: Path) -> None:
    for role in Role:
        whole = find_credentials(folder, role)
        assert whole.certificate == folder / role.value / "certificate.pem"
        assert find_credentials(folder / role.value, role) == whole


def test_private_keys_are_for_their_owner_only(folder: Path) -> None:
    for place in (folder, *(path for path in folder.iterdir() if path.is_dir())):
        assert place.stat().st_mode & 0o077 == 0
    for key in folder.glob("*/key.pem"):
        assert key.stat().st_mode & 0o077 == 0
        key.chmod(0o660)
    with pytest.raises(InputError, match=r"robot/key\.pem"):
        find_credentials(folder, Role.ROBOT)
    with pytest.raises(InputError, match=r"authority/key\.pem"):
        renew_certificates(folder, days=10)


@pytest.mark.parametrize("name", ["key.pem", "certificate.pem", "ca.pem"])
def test_a_missing_broken_or_strange_file_is_named(folder: Path, name: str) -> None:
    path = folder / "robot" / name
    for spoil in (lambda: path.write_text("nonsense"), path.unlink, lambda: os.mkfifo(path, mode=0o600)):
        spoil()
        with pytest.raises(InputError, match=name):
            find_credentials(folder / "robot", Role.ROBOT)


def test_who_may_command_may_also_look_but_not_the_other_way_round(folder: Path) -> None:
    with pytest.raises(InputError, match="viewer"):
        find_credentials(folder / "viewer", Role.CONTROLLER)
    shutil.rmtree(folder / "viewer")
    assert find_credentials(folder, Role.VIEWER).certificate.parent.name == "controller"
    shutil.rmtree(folder / "controller")
    for role in (Role.VIEWER, Role.CONTROLLER):
        with pytest.raises(InputError, match="hexctl keys new"):
            find_credentials(folder, role)


def test_keys_are_never_overwritten(folder: Path) -> None:
    before = (folder / "robot" / "key.pem").read_bytes()
    with pytest.raises(InputError, match="already"):
        make_certificates(folder, hosts=["a"], days=1)
    assert (folder / "robot" / "key.pem").read_bytes() == before


def test_expired_and_future_certificates_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, days in (("old", -30), ("new", 30)):

        class Elsewhen(datetime):
            shift = timedelta(days=days)

            @classmethod
            def now(cls, _tz: object = None) -> "datetime":  # type: ignore[override]
                return datetime.now(UTC) + cls.shift

        with monkeypatch.context() as patched:
            patched.setattr(certificates, "datetime", Elsewhen)
            make_certificates(tmp_path / name, hosts=["a"], days=5)
        with pytest.raises(InputError, match="valid"):
            find_credentials(tmp_path / name, Role.ROBOT)
        assert exit_code(["keys", "show", str(tmp_path / name)]) == 0
        assert ("EXPIRED" in capsys.readouterr().out) == (name == "old")


def test_renewed_certificates_are_good_for_longer_and_beside_the_old(folder: Path, tmp_path: Path) -> None:
    old = shutil.copytree(folder, tmp_path / "old")
    renew_certificates(folder, days=900)
    for role in Role:
        before, after = (load_certificate(place / role.value / CERTIFICATE_FILE) for place in (old, folder))
        assert after.not_valid_after_utc - before.not_valid_after_utc > timedelta(days=889)
        assert hosts_of(after) == hosts_of(before)
        find_credentials(folder, role)
        # An end with the old ones trusts one with the new, and the other way round.
        for certificate, place in ((after, old), (before, folder)):
            certificate.verify_directly_issued_by(load_certificate(place / role.value / AUTHORITY_FILE))


def test_private_keys_that_have_gone_to_their_owners_are_not_needed(folder: Path) -> None:
    (folder / "controller" / "key.pem").rename(folder.with_name("key.pem"))
    before = load_certificate(folder / "controller" / CERTIFICATE_FILE)
    renew_certificates(folder, days=900)
    after = load_certificate(folder / "controller" / CERTIFICATE_FILE)
    assert after.public_key() == before.public_key()
    assert after.not_valid_after_utc > before.not_valid_after_utc


def test_files_that_do_not_belong_together_are_refused(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    make_certificates(other, hosts=["a"], days=1)
    shutil.copy(folder / "viewer" / "key.pem", folder / "robot" / "key.pem")
    with pytest.raises(InputError, match="does not belong to"):
        find_credentials(folder, Role.ROBOT)
    shutil.copy(other / "robot" / "ca.pem", folder / "controller" / "ca.pem")
    with pytest.raises(InputError, match="was not signed by"):
        find_credentials(folder, Role.CONTROLLER)


def test_days_out_of_range_are_refused(folder: Path, tmp_path: Path) -> None:
    for days in (0, 3651):
        with pytest.raises(InputError, match=rf"days: got {days}; allowed: 1\.\.3650"):
            make_certificates(tmp_path / "new", hosts=["a"], days=days)
        with pytest.raises(InputError, match=f"days: got {days}"):
            renew_certificates(folder, days=days)
        assert not (tmp_path / "new").exists()


def test_the_command_makes_and_shows_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (["new", "--host", "robot.local", "--days", "30"], ["show"], ["renew", "--days", "60"]):
        assert exit_code(["keys", *arguments]) == 0
        assert "robot.local" in capsys.readouterr().out or arguments[0] == "new"
    for arguments in (
        ["new"],
        ["new", "b", "--days", "0"],
        ["new", "b", "--host", "tcp/a:1"],
        ["new", "/proc/b"],
        ["show", "nowhere"],
        ["renew", "nowhere"],
        ["renew", "--days", "0"],
    ):
        assert exit_code(["keys", *arguments]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["keys"]


def test_robot_and_controller_share_a_secret_and_without_certificates_anybody_may_stop(folder: Path) -> None:
    link = Link(endpoint="tls/localhost:7447", credentials=folder)
    secret = find_stop_secret(link, Role.ROBOT)
    assert secret is not None
    assert len(secret) == 32
    for credentials in (folder, folder / "controller"):
        assert find_stop_secret(replace(link, credentials=credentials), Role.CONTROLLER) == secret
    assert sorted(path.parent.name for path in folder.rglob(SECRET_FILE)) == ["controller", "robot"]
    assert {path.stat().st_mode & 0o777 for path in folder.rglob(SECRET_FILE)} == {0o600}
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
    assert find_stop_secret(link, Role.ROBOT) == secret


def test_both_ends_get_it_or_none(folder: Path) -> None:
    for path in folder.rglob(SECRET_FILE):
        path.unlink()
    with pytest.raises(InputError):
        write_stop_secret(folder / "controller")
    (folder / "controller" / SECRET_FILE).symlink_to(folder / "nowhere" / "x")
    with pytest.raises(InputError):
        write_stop_secret(folder)
    assert not (folder / "robot" / SECRET_FILE).exists()


@pytest.mark.parametrize(
    ("content", "mode"),
    [
        (b"00" * 31, 0o600),
        (b"no hex", 0o600),
        (b"00" * 1_000_000, 0o600),
        (b"00" * 32, 0o640),
        ("fifo", 0),
        ("/dev/zero", 0),
        ("nothing", 0),
    ],
)
def test_what_is_no_secret_is_refused_and_not_taken_for_a_missing_one(
    folder: Path, content: bytes | str, mode: int
) -> None:
    path = folder / "robot" / SECRET_FILE
    path.unlink()
    if content == "fifo":
        os.mkfifo(path, mode=0o600)
    elif isinstance(content, str):
        path.symlink_to(content)
    else:
        path.write_bytes(content)
        path.chmod(mode)
    with pytest.raises(InputError, match=SECRET_FILE):
        find_stop_secret(Link(endpoint="tls/localhost:7447", credentials=folder), Role.ROBOT)
