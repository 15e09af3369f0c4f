"""The methods that are compared."""

import pytest

from hexctl.control.monitor.recovery import StopWalking
from hexctl.errors import InputError
from hexctl.study.recovery.methods import DEFAULT_METHODS, METHODS, Told, method_of


class MyOwn(Told):
    """A custom method."""


def test_methods_have_names_and_own_ones_a_package() -> None:
    assert DEFAULT_METHODS == tuple(METHODS)[:3] == ("nothing", "told", "recover")
    assert tuple(METHODS)[3:] == ("stop-diagnose", "decentralised", "open-loop-best")
    assert isinstance(method_of("told"), Told)
    assert method_of("recover") is method_of("recover")
    assert isinstance(method_of(f"{__name__}:MyOwn"), MyOwn)
    assert [method_of(name).notices for name in METHODS] == [True, False, True, True, False, False]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "hope",
            "methods: got hope; allowed: nothing, told, recover, stop-diagnose, .*, package.module:Class",
        ),
        ("no.such.module:Hope", "cannot be loaded"),
        (f"{StopWalking.__module__}:StopWalking", "a StopWalking; allowed: a RecoveryMethod"),
    ],
)
def test_what_is_no_method_is_refused(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        method_of(name)
