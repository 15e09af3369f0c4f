"""One Chromium for all tests of pages; they are skipped without it, and fail with HEXCTL_REQUIRE_ALL."""

import os
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from pictures.chromium import chromium
from pictures.needed import MissingProgramError


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A browser of the system."""
    try:
        with chromium() as running:
            yield running
    except MissingProgramError as error:
        (pytest.fail if os.environ.get("HEXCTL_REQUIRE_ALL") else pytest.skip)(str(error))
