"""Keys: one place names them, a robot with names of its own may rename them."""

import pytest

from hexctl.errors import InputError
from hexctl.wire.keys import KINDS, KeyMap


def test_every_kind_has_a_key_of_its_own_under_the_robots_name() -> None:
    keys = KeyMap.of("ant")
    assert {getattr(keys, kind) for kind in KINDS} == {f"hexctl/ant/{kind}" for kind in KINDS}


def test_a_kind_may_travel_under_another_key() -> None:
    keys = KeyMap.of("ant").renamed({"odom": "mocap/ant/odom"})
    assert keys.odom == "mocap/ant/odom"
    assert keys.command == "hexctl/ant/command"


@pytest.mark.parametrize("key", ["", "/a", "a/", "a//b", "a/*", "a/**", "a?b", "a#b", "a b", "$a", "@a"])
def test_what_is_no_plain_key_is_refused(key: str) -> None:
    with pytest.raises(InputError, match="keys: got"):
        KeyMap.of("ant").renamed({"odom": key})


def test_two_kinds_under_one_key_and_unknown_kinds_are_refused() -> None:
    with pytest.raises(InputError, match="a key each"):
        KeyMap.of("ant").renamed({"odom": "hexctl/ant/command"})
    with pytest.raises(InputError, match="allowed: command"):
        KeyMap.of("ant").renamed({"wheels": "a"})
