"""The viewer's program and what is served to it."""

import os
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import parse_qs, urlsplit
from urllib.request import Request, urlopen

import pytest

from hexctl.errors import InputError, RecordingError
from hexctl.recording import viewer
from hexctl.recording.viewer import FileServer, newest_recording, open_viewer, serve_web, web_page, web_url


def test_the_newest_recording_of_all_folders_is_found(tmp_path: Path) -> None:
    for age, name in enumerate(["a.rrd", "session/b.rrd", "c.txt"]):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
        os.utime(path, (1000 + age, 1000 + age))
    assert newest_recording(tmp_path) == tmp_path / "session" / "b.rrd"
    for folder in ("", "missing"):
        with pytest.raises(InputError):
            newest_recording(tmp_path / "none" / folder)
    (tmp_path / "notes.rrd").write_text("hello")
    for name in ("gone.rrd", "notes.rrd"):
        with pytest.raises(InputError, match=name):
            open_viewer([tmp_path / name])


def stand_in(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a program in the viewer's place and return a file that looks like a recording."""
    program = folder / "viewer"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(viewer, "viewer_binary", lambda: program)
    recording = folder / "trial.rrd"
    recording.write_bytes(b"RRF2")
    return recording


def test_the_viewer_gets_the_file_and_listens_to_this_machine_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = stand_in(tmp_path, f'echo "$@" > {tmp_path}/arguments', monkeypatch)
    assert open_viewer([recording]) == 0
    arguments = (tmp_path / "arguments").read_text().split()
    assert arguments[:2] == ["--bind", "127.0.0.1"]
    assert arguments[-1] == str(recording)


def test_a_browser_is_sent_to_the_dark_viewer_of_all_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in(tmp_path, "sleep 60", monkeypatch)
    urls = ["http://127.0.0.1:1/a session/1.rrd", "http://127.0.0.1:1/b.rrd?x=1&y=2"]
    with serve_web(9090, urls) as served:
        assert served.poll() is None
    page = web_page(9090, urls)
    assert page.startswith("http://127.0.0.1:9090/?")
    asked = parse_qs(urlsplit(page).query)
    assert asked == {"theme": ["dark"], "url": urls}
    live = parse_qs(urlsplit(web_url(1234, 9090)).query)
    assert live == {"theme": ["dark"], "url": ["rerun+http://127.0.0.1:1234/proxy"]}


NO_DISPLAY = "Error: winit EventLoopError: neither WAYLAND_DISPLAY nor WAYLAND_SOCKET nor DISPLAY is set."


@pytest.mark.parametrize(("said", "told"), [(NO_DISPLAY, "--web"), ("info\\nError: no GPU", "no GPU")])
def test_an_error_of_the_viewer_is_passed_on_in_one_line(
    said: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = stand_in(tmp_path, f'printf "{said}\\n" >&2; exit 3', monkeypatch)
    with pytest.raises(RecordingError, match=told) as refusal:
        open_viewer([recording])
    assert "\n" not in str(refusal.value)


ORIGIN = "http://127.0.0.1:9090"


def recording_in(folder: Path, name: str) -> Path:
    path = folder / name
    path.write_bytes(b"RRF2" + name.encode())
    return path


def status_of(url: str, method: str = "GET", **headers: str) -> int:
    """HTTP status of an answer."""
    try:
        with urlopen(Request(url, headers=headers, method=method)) as answer:  # noqa: S310  loopback
            return int(answer.status)
    except HTTPError as error:
        return error.code


def test_recordings_that_were_added_are_served_to_pages_of_the_viewer_and_nothing_else(
    tmp_path: Path,
) -> None:
    (tmp_path / "secret").touch()
    (tmp_path / "notes.rrd").write_text("hello")
    recording_in(tmp_path, "other.rrd")
    path = recording_in(tmp_path, "ein großer 1%.rrd")
    with FileServer(ORIGIN) as server:
        url = server.add("a session", path)
        assert url.startswith("http://127.0.0.1:")
        assert url.startswith(server.base("a session"))
        with urlopen(url) as answer:  # noqa: S310  loopback
            assert answer.read() == path.read_bytes()
            assert answer.headers["Access-Control-Allow-Origin"] == ORIGIN
        for method in ("GET", "HEAD"):
            assert status_of(url, method) == 200
            for name in ("other.rrd", "../secret", "%2e%2e/secret", "", "/etc/passwd"):
                assert status_of(server.base("a session") + name, method) == 404
            assert status_of(url, method, Host="evil.example") == 403
        with pytest.raises(InputError, match=r"notes\.rrd"):
            server.add("here", tmp_path / "notes.rrd")
        path.unlink()
        assert status_of(url) == 404
