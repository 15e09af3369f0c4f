"""YAML of strangers: refused with its place, before it takes time or memory."""

import pytest

from hexctl.robot.yaml_text import MOST_NODES, yaml_content

#: Nine to the eighth entries in nine lines.
MERGES = "a0: &a0 {x: 1}\n" + "".join(
    f"a{level}: &a{level} {{<<: [{', '.join([f'*a{level - 1}'] * 9)}]}}\n" for level in range(1, 9)
)
ALIASES = "a0: &a0 [1]\n" + "".join(
    f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n" for level in range(1, 12)
)

HOSTILE = {
    "a long hexadecimal number": "x: 0x" + "f" * 200_000,
    "a long number": "x: " + "9" * 5000,
    "a long number of base 60": "x: 1" + ":59" * 20_000,
    "a long fraction of base 60": "x: 1" + ":59" * 400 + ".5",
    "a long binary number": "x: -0b1" + "0" * 100,
    "merges": MERGES,
    "aliases": ALIASES,
    "a list that refers to itself": "&a [*a]",
    "a mapping that refers to itself": "x: &a {y: *a}",
    "a merge that refers to itself": "x: &a {<<: *a}",
    "no int": 'x: !!int ""',
    "no float": 'x: !!float ""',
    "no bool": "x: !!bool maybe",
    "no timestamp": "x: !!timestamp now",
    "an impossible date": "x: 2026-13-01",
    "no base64": "x: !!binary é",
    "no set": "x: !!set [1]",
    "a list as a key": "? [1]\n: 2",
    "a key twice": "x: 1\nx: 2",
    "a deep list": "[" * 400,
}


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_text_is_refused(what: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        yaml_content(HOSTILE[what])


def test_a_refusal_has_its_place() -> None:
    with pytest.raises(ValueError, match="line 2, column 1"):
        yaml_content("x: 1\nx: 2")
    with pytest.raises(ValueError, match=str(MOST_NODES)):
        yaml_content(ALIASES)


def test_anchors_as_a_person_writes_them_are_read() -> None:
    text = "leg: &leg {mass_kg: 0.1, at: [1, 2]}\nother: {<<: *leg, mass_kg: 0.2}\nlist: [*leg, *leg]\n"
    content = yaml_content(text)
    assert content["other"] == {"mass_kg": 0.2, "at": [1, 2]}
    assert content["list"] == [content["leg"]] * 2
    assert yaml_content("") is None
    assert yaml_content("x: 0x1f\ny: 1:30\nz: 1e3\n") == {"x": 31, "y": 90, "z": "1e3"}
