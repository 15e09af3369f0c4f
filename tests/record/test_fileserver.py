from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest

from hexctl.errors import InputError
from hexctl.record.fileserver import FileServer

ORIGIN = "http://127.0.0.1:9090"


@pytest.fixture
def server() -> Iterator[FileServer]:
    with FileServer(ORIGIN) as server:
        yield server


def recording(folder: Path, name: str) -> Path:
    path = folder / name
    path.write_bytes(b"RRF2" + name.encode())
    return path


def test_what_was_added_is_served_to_pages_of_the_viewer(server: FileServer, tmp_path: Path) -> None:
    path = recording(tmp_path, "ein großer 1%.rrd")
    url = server.add("a session", path)
    assert url.startswith("http://127.0.0.1:")
    assert url.startswith(server.base("a session"))
    with urlopen(url) as answer:  # noqa: S310  loopback
        assert answer.read() == path.read_bytes()
        assert answer.headers["Access-Control-Allow-Origin"] == ORIGIN


@pytest.mark.parametrize("name", ["other.rrd", "../secret", "%2e%2e/secret", "", "/etc/passwd"])
def test_nothing_else_is_served(server: FileServer, tmp_path: Path, name: str) -> None:
    (tmp_path / "secret").touch()
    recording(tmp_path, "other.rrd")
    server.add("here", recording(tmp_path, "trial.rrd"))
    with pytest.raises(HTTPError, match="404"):
        urlopen(server.base("here") + name)  # noqa: S310  loopback


def test_a_file_that_is_gone_is_not_found(server: FileServer, tmp_path: Path) -> None:
    path = recording(tmp_path, "trial.rrd")
    url = server.add("here", path)
    path.unlink()
    with pytest.raises(HTTPError, match="404"):
        urlopen(url)  # noqa: S310  loopback


def test_only_recordings_are_served(server: FileServer, tmp_path: Path) -> None:
    (tmp_path / "notes.rrd").write_text("hello")
    with pytest.raises(InputError, match="not a Rerun recording"):
        server.add("here", tmp_path / "notes.rrd")


def test_a_page_of_another_name_that_leads_here_is_refused(server: FileServer, tmp_path: Path) -> None:
    url = server.add("here", recording(tmp_path, "trial.rrd"))
    request = Request(url, headers={"Host": "evil.example"})  # noqa: S310  loopback
    with pytest.raises(HTTPError, match="403"):
        urlopen(request)  # noqa: S310  loopback
