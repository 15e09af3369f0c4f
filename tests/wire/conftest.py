"""Certificates of two authorities that know nothing of each other."""

from pathlib import Path

import pytest

from hexctl.wire.certificates import make_certificates


@pytest.fixture(scope="session")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tls") / "keys"
    make_certificates(folder, hosts=["127.0.0.1"], days=1)
    return folder


@pytest.fixture(scope="session")
def other_authority(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("other") / "keys"
    make_certificates(folder, hosts=["127.0.0.1"], days=1)
    return folder
