"""The entry point names modules that exist: what hangs at the end would hang for ever otherwise."""

from importlib.util import find_spec

import pytest

from hexctl.cli.entry import MAY_HANG


@pytest.mark.parametrize("name", MAY_HANG)
def test_a_module_that_may_hang_exists(name: str) -> None:
    assert find_spec(f"hexctl.{name}") is not None
