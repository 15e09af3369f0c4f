"""YAML of strangers: refused with its place, before it takes time or memory."""

import re

import pytest

from hexctl.robot.yaml_text import MOST_NODES, yaml_content

#: Nine to the eighth entries in nine lines.
MERGES = "a0: &a0 {x: 1}\n" + "".join(
    f"a{level}: &a{level} {{<<: [{', '.join([f'*a{level - 1}'] * 9)}]}}\n" for level in range(1, 9)
)
ALIASES = "a0: &a0 [1]\n" + "".join(
    f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n" for level in range(1, 12)
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x: 0x" + "f" * 200_000, "line 1, column 4: got a number of 200002 signs; allowed: up to 50"),
        ("x: " + "9" * 5000, "got a number of 5000 signs"),
        ("x: 1" + ":59" * 20_000, "got a number of 60001 signs"),
        ("x: 1" + ":59" * 400 + ".5", "got a number of 1203 signs"),
        ("x: -0b1" + "0" * 100, "got a number of 104 signs"),
        (MERGES, f"it is larger than {MOST_NODES} values with its aliases followed"),
        (ALIASES, f"it is larger than {MOST_NODES} values with its aliases followed"),
        ("&a [*a]", "line 1, column 1: it refers to itself"),
        ("x: &a {y: *a}", "it refers to itself"),
        ("x: &a {<<: *a}", "it refers to itself"),
        ('x: !!int ""', "line 1, column 4: got '', which is no int"),
        ('x: !!float ""', "which is no float"),
        ("x: !!bool maybe", "got 'maybe', which is no bool"),
        ("x: !!timestamp now", "got 'now', which is no timestamp"),
        ("x: 2026-13-01", "which is no timestamp"),
        ("x: !!binary é", "failed to convert base64 data"),
        ("x: !!set [1]", "expected a mapping node"),
        ("? [1]\n: 2", "found unhashable key"),
        ("x: 1\nx: 2", "line 2, column 1: the key 'x' is given twice"),
        ("[" * 5000, "it is nested too deeply"),
    ],
    ids=lambda text: text[:20],
)
def test_refused_with_its_place(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        yaml_content(text)


def test_anchors_as_a_person_writes_them_are_read() -> None:
    text = "leg: &leg {mass_kg: 0.1, at: [1, 2]}\nother: {<<: *leg, mass_kg: 0.2}\nlist: [*leg, *leg]\n"
    content = yaml_content(text)
    assert content["other"] == {"mass_kg": 0.2, "at": [1, 2]}
    assert content["list"] == [content["leg"]] * 2
    assert yaml_content("") is None
    assert yaml_content("x: 0x1f\ny: 1:30\nz: 1e3\n") == {"x": 31, "y": 90, "z": "1e3"}
