"""Imports lose no mass in silence, doubt other units, follow the names of legs, and end for hostile files."""

import os
import random
import re
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from unittest.mock import patch

import mujoco
import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.configs import config_names
from hexctl.robot.formats.importing import mjcf_process
from hexctl.robot.formats.importing.leg_names import forward_by_names
from hexctl.robot.formats.importing.mesh_files import find_mesh
from hexctl.robot.formats.importing.robot_import import ImportedRobot, import_robot
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from tests.cli.terminals import run_program
from tests.robot.hexapods import BOX, INERTIAL, MOUNTS, fixed, hexapod, imported, inertial
from tests.robot.meshmaking import stl_box
from tests.robot.test_robot_import import MJCF, scaled
from tests.robots import Edit, edited_file, put

# -- masses


def made_kg(made: ImportedRobot) -> float:
    links = made.content["links"].values()
    return float(made.content["body"]["mass_kg"] + 6 * sum(link["mass_kg"] for link in links))


def file_kg(text: str) -> float:
    if text.startswith("<robot") or "<robot" in text[:200]:
        return sum(map(float, re.findall(r'<mass value="([^"]*)"', text)))
    return float(mujoco.MjModel.from_xml_string(text).body_mass.sum())


def part(name: str, parent: str, draw: random.Random, kind: str = "") -> str:
    """A link of a random mass on a random joint."""
    kg = draw.choice([0.02, 0.1, 0.35])
    inside = inertial(str(kg), "1e-5", "1e-5", "1e-5") if draw.random() < 0.8 else ""
    kind = kind or draw.choice(["fixed", "revolute", "continuous", "prismatic", "floating"])
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    text = fixed(name, parent, inside, f"{draw.uniform(-0.04, 0.04):.3f} 0 0.02", kind)
    return text.replace("<axis", f"{limit}<axis")


def drawn(seed: int) -> str:
    """A hexapod with heads, arms and sensors on its trunk, and parts on its coxae, femora and shins."""
    draw = random.Random(seed)
    more = ""
    for branch in range(draw.randrange(4)):
        parent = "base"
        for number in range(draw.randrange(1, 6)):
            more += part(f"x{branch}_{number}", parent, draw, draw.choice(["", "revolute"]))
            parent = f"x{branch}_{number}"
    per_leg = part("y{n}", draw.choice("cft") + "{n}", draw, draw.choice(["fixed", "prismatic"]))
    return hexapod(trunk=BOX, more=more, more_per_leg=per_leg if draw.random() < 0.5 else "")


def text_of(form: Callable[[Robot], str], name: str) -> str:
    """A shipped robot in another format."""
    return form(load_robot(name))


TEXTS: dict[str, Callable[[], str]] = {
    **{f"{name}.urdf": partial(text_of, urdf_of, name) for name in config_names("robots")},
    **{f"{name}.xml": partial(text_of, mjcf_of, name) for name in config_names("robots")},
    **{f"drawn {seed}": partial(drawn, seed) for seed in range(46)},
}


@pytest.mark.parametrize("name", TEXTS)
def test_the_mass_of_a_file_is_that_of_its_robot_or_the_difference_is_named(
    name: str, tmp_path: Path
) -> None:
    text = TEXTS[name]()
    made = imported(tmp_path, text)
    named = [note for note in made.notes if "masses in the file" in note]
    if not named:
        assert made_kg(made) == pytest.approx(file_kg(text), rel=2e-4)
    elif name.startswith("drawn"):
        pytest.fail(f"nothing is assumed of this robot: {named}")


@pytest.mark.parametrize("hinges", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("arms", [1, 2])
def test_arms_are_no_legs_and_their_masses_are_those_of_the_trunk(
    hinges: int, arms: int, tmp_path: Path
) -> None:
    more = ""
    for arm in range(arms):
        parent = "base"
        for number in range(hinges):
            name = f"arm{arm}_{number}"
            link = fixed(name, parent, inertial("0.1", "1e-5", "1e-5", "1e-5"), "0.09 0 0", "revolute")
            more += link.replace('"1 0 0"', '"0 1 0"' if number else '"0 0 1"')
            parent = name
    made = imported(tmp_path, hexapod(more=more))
    assert made.content["mounts"] == imported(tmp_path, hexapod()).content["mounts"]
    assert made.content["body"]["mass_kg"] == pytest.approx(1.2 + 0.1 * hinges * arms)
    assert any("on_arm0_0" in note for note in made.notes)


#: The trunk of the MJCF.
SHELL = '<geom type="box" size="0.11 0.09 0.025" mass="1"/>'


def test_a_mass_of_an_mjcf_survives_a_missing_mesh(tmp_path: Path) -> None:
    text = MJCF.replace("<worldbody>", '<asset><mesh name="lost" file="lost.stl"/></asset><worldbody>')
    made = imported(tmp_path, text.replace(SHELL, '<geom type="mesh" mesh="lost" mass="0.8"/>'))
    assert made.content["body"]["mass_kg"] == pytest.approx(0.8)
    assert "body.mass_kg" not in made.unknown
    assert "body.inertia_kg_m2" in made.unknown
    partly = imported(tmp_path, text.replace(SHELL, SHELL + '<geom type="mesh" mesh="lost"/>'))
    assert partly.content["body"]["mass_kg"] == pytest.approx(1.0)
    assert "lost.stl" in partly.reasons["body.mass_kg"]


@pytest.mark.parametrize("folder", ["", "meshes"])
def test_a_mesh_is_found_from_the_folder_of_a_relative_mjcf(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "some" / folder).mkdir(parents=True)
    (tmp_path / "some" / folder / "box.stl").write_bytes(stl_box())
    monkeypatch.chdir(tmp_path)
    mesh = '<asset><mesh name="box" file="box.stl" scale="0.2 0.2 0.05"/></asset><worldbody>'
    text = MJCF.replace("<worldbody>", f'<compiler meshdir="{folder}"/>{mesh}')
    text = text.replace(SHELL, '<geom type="mesh" mesh="box"/>')
    assert imported(Path("some"), text).content["body"]["mass_kg"] == pytest.approx(2.0)
    monkeypatch.setattr("hexctl.robot.formats.importing.mjcf_tree.MOST_MESH_BYTES", 500)
    unread = imported(Path("some"), text)
    assert unread.content["body"]["mass_kg"] == pytest.approx(2.0)
    assert "body.mass_kg" not in unread.unknown
    assert "body.inertia_kg_m2" in unread.unknown


def test_masses_that_are_no_part_of_the_robot_are_named(tmp_path: Path) -> None:
    world = hexapod(trunk=BOX).replace('name="r" type="fixed"', 'name="r" type="floating"')
    text = world.replace('<link name="root"/>', f'<link name="root">{INERTIAL}</link>')
    table = MJCF.replace("</worldbody>", '<body name="root"><geom size="0.1" mass="3"/></body></worldbody>')
    ball = re.sub('<body pos="0 0 1"><freejoint/>', '<body pos="0 0 1">', table)
    ball = ball.replace('name="root"><geom', 'name="root"><freejoint/><geom')
    for one in (text, table, ball):
        note = next(note for note in imported(tmp_path, one).notes if "masses in the file" in note)
        assert "root, " in note


def test_a_mesh_is_found_by_another_case_a_space_and_a_package(tmp_path: Path) -> None:
    (tmp_path / "Meshes").mkdir()
    for name in ("trunk.stl", "top plate.stl", "Kö.stl"):
        (tmp_path / "Meshes" / name).write_bytes(stl_box())
    for name, file in {
        "meshes/Trunk.STL": "trunk.stl",
        "meshes/top%20plate.stl": "top plate.stl",
        "package://any/MESHES/top%20Plate.stl": "top plate.stl",
        "$(find any)/meshes/trunk.stl": "trunk.stl",
        "meshes\\ko\u0308.stl": "Kö.stl",
    }.items():
        assert find_mesh(name, tmp_path) == tmp_path / "Meshes" / file
    assert find_mesh("meshes/other.stl", tmp_path) is None


# -- the front


PLACES = np.array([mount[:2] for mount in MOUNTS])
WORDS = {
    "{end}_{side}_coxa": ("front", "middle", "rear", "left", "right"),
    "{side}{end}_HAA": ("F", "M", "H", "L", "R"),
    "coxa_{end}{side}": ("f", "m", "r", "l", "r"),
    "leg{side}{end}": ("Front", "Mid", "Back", "Left", "Right"),
    "{side}{end}1": ("", "", "", "l", "r"),
}


@pytest.mark.parametrize("words", WORDS)
@pytest.mark.parametrize(("axis", "turn"), [("x", 0), ("y", 1), ("-x", 2), ("-y", 3)])
def test_the_names_of_legs_show_the_front(words: str, axis: str, turn: int) -> None:
    front, middle, rear, left, right = WORDS[words]
    ends = [front, middle, rear, rear, middle, front]
    names = [[words.format(end=end, side=left if n < 3 else right), f"c{n}"] for n, end in enumerate(ends)]
    at = (PLACES[:, 0] + 1j * PLACES[:, 1]) * 1j**turn
    mounts_m = np.column_stack([at.real, at.imag, np.zeros(6)])
    assert forward_by_names(names, mounts_m, np.array([0.0, 0.0, 1.0])) == [axis]


def test_a_front_by_names_is_noted_and_an_option_decides(tmp_path: Path) -> None:
    text = hexapod()
    for n, name in enumerate(
        ("rear_right", "mid_right", "front_right", "front_left", "mid_left", "rear_left"), 1
    ):
        text = text.replace(f'"jc{n}"', f'"{name}"')
    made = imported(tmp_path, text)
    assert "leg 1: front_left" in made.text
    assert any("--forward -x" in note for note in made.notes)
    kept = imported(tmp_path, text, forward="x")
    assert "leg 1: rear_right" in kept.text
    assert any("--forward -x" in note for note in kept.notes)
    mirrored = re.sub(
        '"(front|mid|rear)_(left|right)"',
        lambda m: f'"{m[1]}_{"left" if m[2] == "right" else "right"}"',
        text,
    )
    note = next(note for note in imported(tmp_path, mirrored).notes if "--forward" in note)
    assert "--forward -x" in note
    assert "--forward x" in note


# -- units


UNITS = {
    "in g that is 1.2 kg": lambda: re.sub(
        r'<mass value="([^"]*)"', lambda m: f'<mass value="{1000 * float(m[1])}"', hexapod()
    ),
    "legs with the decimal point moved that is 0.24 m": lambda: re.sub(
        r'value="([^"]*)"', lambda m: f'value="{float(m[1]) / 1000}"', scaled(hexapod(trunk=BOX), 10)
    ),
    "legs with the decimal point moved that is 0.24 m; masses in g": lambda: re.sub(
        r'value="([^"]*)"', lambda m: f'value="{1000 * float(m[1])}"', scaled(hexapod(trunk=BOX), 0.1)
    ),
    "in inches that is 0.24 m": lambda: re.sub(
        r'value="([^"]*)"', lambda m: f'value="{float(m[1]) / 39.37**3}"', scaled(hexapod(trunk=BOX), 39.37)
    ),
}


@pytest.mark.parametrize("units", UNITS)
def test_masses_and_lengths_that_do_not_fit_are_refused(units: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=units):
        imported(tmp_path, UNITS[units]())


@pytest.mark.parametrize("share", [0.05, 0.1, 20.0])
def test_moments_of_another_mass_are_doubted(share: float, tmp_path: Path) -> None:
    box = [1.2 / 12 * (b**2 + c**2) * share for b, c in ((0.18, 0.05), (0.22, 0.05), (0.22, 0.18))]
    made = imported(tmp_path, hexapod(trunk=BOX, trunk_inertial=inertial("1.2", *map(str, box))))
    assert "body.inertia_kg_m2" in made.unknown


@pytest.mark.parametrize(
    ("edits", "key"),
    [
        (
            [put("body", "mass_kg", 500.0)]
            + [put("links", k, "mass_kg", 30.0) for k in ("coxa", "femur", "tibia")],
            "in g that is 0.5, 0.03 kg",
        ),
        (
            [
                put("joints", k, e, v)
                for k in ("coxa", "femur", "tibia")
                for e, v in (("min_deg", -1.0), ("max_deg", 1.0))
            ],
            "joints: .*in rad that is -57.3, 57.3 deg",
        ),
    ],
)
def test_a_robot_file_in_other_units_is_refused(edits: list[Edit], key: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=key):
        load_robot(edited_file(tmp_path, *edits))


# -- hostile files


def with_head(head: str) -> str:
    return MJCF.replace("<worldbody>", f"{head}<worldbody>")


def with_part(text: str) -> str:
    return MJCF.replace("</worldbody>", f"{text}</worldbody>")


MEGABYTE = "a" * 1_000_000
HOSTILE = {
    "replicate": with_part('<replicate count="100000000"><geom size="1"/></replicate>'),
    "nested replicates": with_part(30 * '<replicate count="9">' + '<geom size="1"/>' + 30 * "</replicate>"),
    "flexcomp": with_part('<body><flexcomp name="f" type="grid" count="300 300 300" dim="3"/></body>'),
    "hfield": with_head('<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'),
    **{
        f"a pipe, {words}": f"<mujoco>{before}<include file={name}/>{after}</mujoco>"
        for words, before, name, after in (
            ("plain", "", '"pipe"', ""),
            ("escaped", "", '"&#x70;ipe"', ""),
            ("between comments in attributes", '<option a="<!--"/>', '"pipe"', '<option a="-->"/>'),
            ("between comments in CDATA", "<![CDATA[<!--]]>", '"pipe"', "<![CDATA[-->]]>"),
            ("after a megabyte of a name", "<" + MEGABYTE, '"pipe"', ""),
            ("after a megabyte of an attribute", f"<a {MEGABYTE}>", '"pipe"', ""),
            ("before comments", "", '"pipe"', "<!--" * 250_000),
        )
    },
    "a pipe after a space": "<mujoco>< include file='pipe'/></mujoco>",
    "a negative count": with_part('<replicate count="-1e9"><geom size="1"/></replicate>'),
    "a count that is no number": with_part('<replicate count="nan"><geom size="1"/></replicate>'),
    "itself": with_head('<include file="some.xml"/>'),
    "a built-in mesh": with_head('<asset><mesh name="m" builtin="supersphere" params="30000 1 1"/></asset>'),
    "files of files": with_head('<asset><model name="m0" file="m0"/></asset>').replace(
        "</worldbody>", '<attach model="m0" body="b" prefix="a"/></worldbody>'
    ),
    "elements": f'<robot name="a">{"<a/>" * 300_000}</robot>',
    "chains of 40 hinges": hexapod(
        foot="",
        more_per_leg="".join(
            fixed(
                f"L{{n}}a{i}", f"L{{n}}a{i - 1}" if i else "t{n}", INERTIAL, "0.01 0 0", "continuous"
            ).replace('"1 0 0"', '"0 1 0"')
            for i in range(37)
        ),
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_description_is_refused_before_it_is_compiled(case: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for n in range(9):
        attach = "".join(f'<attach model="m{n + 1}" body="b" prefix="{i}"/>' for i in range(9))
        (tmp_path / f"m{n}").write_text(
            f'<mujoco><asset><model name="m{n + 1}" file="m{n + 1}"/></asset><worldbody><body name="b">'
            f"{attach}</body></worldbody></mujoco>"
        )
    path = tmp_path / ("some.xml" if HOSTILE[case].startswith("<mujoco") else "some.urdf")
    path.write_text(HOSTILE[case], encoding="utf-8")
    with (
        patch.object(mjcf_process, "_answer", side_effect=AssertionError("MuJoCo was called")),
        pytest.raises(InputError) as refused,
    ):
        import_robot(path)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_mujoco_runs_in_a_child_that_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "some.xml"
    path.write_text(MJCF, encoding="utf-8")
    assert import_robot(path).content == imported(tmp_path, MJCF).content
    with patch.object(mjcf_process, "TIMEOUT_S", 0.01), pytest.raises(InputError, match=r"some\.xml"):
        import_robot(path)
    path.write_text(with_head('<size memory="900G"/>'), encoding="utf-8")
    with pytest.raises(InputError, match=r"some\.xml.* MB"):
        import_robot(path)
    (tmp_path / "mujoco.py").write_text("raise IndexError('last words')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match="last words"):
        import_robot(path)


#: Sets the limits of the child under other limits, and with the signals of a command.
LIMITED = """
import resource, signal, time
from hexctl.robot.formats.importing import mjcf_process
resource.setrlimit(resource.RLIMIT_DATA, (300_000_000, 300_000_000))
signal.signal(signal.SIGALRM, signal.SIG_IGN)
mjcf_process.MOST_S = 0.1
mjcf_process._limit()
time.sleep(60)
"""


def test_the_child_ends_without_its_parent_and_keeps_narrower_limits() -> None:
    assert run_program(LIMITED).returncode == -signal.SIGALRM
