"""hexctl's own errors travel between processes, as those of a study's workers do."""

import pickle

import pytest

from hexctl import errors
from hexctl.errors import HexctlError, MissingExtraError

KINDS = [
    kind
    for kind in vars(errors).values()
    if isinstance(kind, type) and issubclass(kind, HexctlError) and kind is not MissingExtraError
]


def test_a_missing_extra_travels_with_its_text() -> None:
    error = MissingExtraError("the simulation", "sim")
    there = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert type(there) is MissingExtraError
    assert str(there) == str(error) == 'the simulation needs the "sim" extra: pip install "hexctl[sim]"'


@pytest.mark.parametrize("kind", KINDS)
def test_every_error_travels_with_its_text(kind: type[HexctlError]) -> None:
    there = pickle.loads(pickle.dumps(kind("one line")))  # noqa: S301
    assert type(there) is kind
    assert str(there) == "one line"
