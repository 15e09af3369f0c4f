"""Link files: found by name or path, checked, and outdone by what is given besides."""

from pathlib import Path

import pytest

from hexctl.errors import InputError
from hexctl.wire.link import DEFAULT_ENDPOINT, Link
from hexctl.wire.linkfile import load_link


def test_without_a_file_it_is_the_shipped_loopback() -> None:
    assert load_link() == load_link("loopback") == Link(endpoint=DEFAULT_ENDPOINT)


def test_a_file_is_read_and_what_is_given_besides_wins(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(
        "endpoint: tls/robot.local:7447\ncredentials: ./keys\nnames: {odom: mocap/ant/odom}\nplain: true\n"
    )
    link = load_link(str(path))
    assert link.endpoint == "tls/robot.local:7447"
    assert link.credentials == tmp_path / "keys"
    assert link.plain
    assert link.keys("ant").odom == "mocap/ant/odom"
    given = load_link(str(path), endpoint="tls/other:1", credentials=Path("mine"))
    assert (given.endpoint, given.credentials) == ("tls/other:1", Path("mine"))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("endpoints: tcp/a:1", "endpoints"),
        ("insecure: 1", "insecure"),
        ("names: [a]", "names"),
        ("endpoint: 5", "endpoint"),
        ("- a", "mapping"),
    ],
)
def test_a_file_that_is_none_is_refused_with_its_key(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(content)
    with pytest.raises(InputError, match=words) as refused:
        load_link(str(path))
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="loopback"):
        load_link("moon")
