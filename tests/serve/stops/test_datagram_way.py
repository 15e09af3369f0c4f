"""The datagrams of a stop: what keeps them from being sent is told."""

import threading
from pathlib import Path

import pytest

from hexctl.serve.stops.datagram_way import DatagramWay
from hexctl.waiting import comes_true
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import Link
from hexctl.wire.stop_secret import SECRET_FILE


def began(link: Link) -> DatagramWay:
    way = DatagramWay(link, b"mine    ", threading.Event(), lambda _: None)
    way.begin()
    return way


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_name_that_no_host_can_have_is_trouble() -> None:
    way = began(Link(endpoint="tcp/robot..local:7447", insecure=True))
    try:
        assert comes_true(lambda: way.trouble is not None, 10.0)
        assert "robot..local is not known here" in (way.trouble or "")
    finally:
        way.end()


def test_a_folder_without_the_secret_and_quic_are_trouble(tmp_path: Path) -> None:
    make_certificates(tmp_path / "keys", hosts=["localhost"], days=1)
    for path in tmp_path.rglob(SECRET_FILE):
        path.unlink()
    for link, said in (
        (Link(endpoint="tls/localhost:7447", credentials=tmp_path / "keys"), "hexctl keys stop makes one"),
        (Link(endpoint="quic/localhost:7447"), "quic"),
    ):
        way = began(link)
        assert said in (way.trouble or "")
        way.end()
