"""Robot files from URDF: of others, and what is no such robot.

`phantomx_humarobotics.urdf` is from phantomx_description by HumaRobotics (Generation Robots), under the
Simplified BSD License beside it.
"""

import math
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.formats.importing.robot_import import import_robot
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.runs.run import run
from hexctl.types import N_JOINTS
from tests.robot.hexapods import imported
from tests.robots import shipped

PHANTOMX = Path(__file__).parents[1] / "data" / "phantomx_humarobotics.urdf"
PHANTOMX_FOOT_M = (0.0, 0.13, 0.0)


def with_links(text: str, count: int, parent: str, at: str = "0 0 0") -> str:
    """A URDF with a chain of further links that are fixed to one another."""
    more = []
    for number in range(count):
        more.append(
            f'<link name="more{number}"/><joint name="fixes{number}" type="fixed"><parent link="{parent}"/>'
            f'<child link="more{number}"/><origin xyz="{at}"/></joint>'
        )
        parent = f"more{number}"
    return text.replace("</robot>", "".join(more) + "</robot>")


def test_a_robot_has_hundreds_of_links_at_most(tmp_path: Path) -> None:
    robot = shipped("ant")
    back = imported(tmp_path, with_links(urdf_of(robot), 400, "base_link"))
    assert back.robot().mass_kg == pytest.approx(robot.mass_kg, rel=1e-3)
    with pytest.raises(InputError, match="links"):
        imported(tmp_path, with_links(urdf_of(robot), 2500, "leg1_foot"))


def test_names_frames_and_directions_of_turning_do_not_matter(tmp_path: Path) -> None:
    """The same legs with other names, in another order, and with the tibiae turning the other way."""
    robot = shipped("phantomx")
    text = urdf_of(robot)
    for leg in range(1, 7):
        text = text.replace(f"leg{leg}_", f"bein{(leg * 5) % 7}_")
    text = text.replace("_coxa", "_a").replace("_femur", "_b").replace("_tibia", "_c")
    head, tail = text.split('<joint name="bein1_c"', 1)
    tail = tail.replace('xyz="0 -1 0"', 'xyz="0 1 0"', 1)
    tail = re.sub(
        r'lower="(\S+)" upper="(\S+)"',
        lambda m: f'lower="{-float(m[2])}" upper="{-float(m[1])}"',
        tail,
        count=1,
    )
    made = imported(tmp_path, head + '<joint name="bein1_c"' + tail)
    back = made.robot()
    assert back.link_vectors_m == pytest.approx(robot.link_vectors_m, abs=1e-4)
    assert back.mount_positions_body == pytest.approx(robot.mount_positions_body, abs=1e-4)
    assert back.joint_lower_rad == pytest.approx(robot.joint_lower_rad, abs=1e-4)
    assert "(bein1_c)" in made.text
    assert "(bein2_c)" not in made.text


def test_a_robot_that_looks_elsewhere_is_turned(tmp_path: Path) -> None:
    robot = shipped("phantomx")
    text = urdf_of(robot).replace(
        '<link name="base_link" />', '<link name="root" /><link name="base_link" />'
    )
    turned = '<joint name="turn" type="fixed"><parent link="root" /><child link="base_link" />'
    turned += f'<origin xyz="0 0 0.2" rpy="0 0 {math.pi / 2}" /></joint></robot>'
    text = text.replace("</robot>", turned)
    back = imported(tmp_path, text, forward="y").robot()
    assert back.mount_positions_body == pytest.approx(robot.mount_positions_body, abs=1e-4)
    sideways = imported(tmp_path, text).robot()
    assert abs(sideways.mount_positions_body[:, 0]).max() == pytest.approx(0.1, abs=1e-4)


def test_a_urdf_that_others_wrote_agrees_with_mujoco_and_walks(tmp_path: Path) -> None:
    made = import_robot(PHANTOMX, foot_m=PHANTOMX_FOOT_M)
    assert {"body.size_m", "foot_radius_m", "links.tibia.inertia_kg_m2"} <= set(made.unknown)
    assert "links.tibia.end_m" not in made.unknown
    file = tmp_path / "mine.yaml"
    file.write_text(made.text, encoding="utf-8")
    robot = load_robot(file)
    assert load_robot_file(file).to_measure == made.unknown
    # MuJoCo reads the file itself, without its meshes; joints and signs are those of the comments.
    text = re.sub(r"<(visual|collision)>.*?</\1>", "", PHANTOMX.read_text(encoding="utf-8"), flags=re.DOTALL)
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    for body in spec.bodies:
        if body.name.startswith("tibia"):
            body.add_site(name=f"foot_{body.name[6:]}", pos=PHANTOMX_FOOT_M)
    model = spec.compile()
    data = mujoco.MjData(model)
    legs = re.findall(r"# +leg \d: (.*)", made.text)
    frame_m = np.array(re.findall(r"frame is at (\S+), (\S+), (\S+) m", made.text)[0], dtype=float)
    assert [leg.split(",")[0] for leg in legs] == [
        f"j_c1_{side}" for side in ("lf", "lm", "lr", "rr", "rm", "rf")
    ]
    shares = np.random.default_rng(17).uniform(size=(20, N_JOINTS))
    for pose_rad in robot.joint_lower_rad + shares * (robot.joint_upper_rad - robot.joint_lower_rad):
        for leg, names in enumerate(legs):
            for index, name in enumerate(names.split(", ")):
                sign = -1 if name.startswith("(") else 1
                joint = model.joint(name.strip("()")).qposadr[0]
                data.qpos[joint] = sign * pose_rad[3 * leg + index]
        mujoco.mj_kinematics(model, data)
        feet_m = np.array([data.site(f"foot_{leg.split(',')[0][5:]}").xpos for leg in legs])
        # Its author wrote 1.5707 and 4.7123 for quarter turns.
        assert feet_m - frame_m == pytest.approx(foot_positions_body(robot, pose_rad), abs=5e-4)
    walked = run(robot=str(file), gait="tripod", duration_s=6, record=False).trial
    assert walked.status == "ok"
    assert walked.distance_m is not None
    assert walked.ideal_distance_m is not None
    assert walked.distance_m > 0.7 * walked.ideal_distance_m


#: What is replaced once in a URDF of `ant`, by what, and the word of the message that names it.
CHANGES = {
    "five legs": ('"leg6_coxa" type="revolute"', '"leg6_coxa" type="fixed"', "5 chains"),
    "a leaning hip": ('<axis xyz="0 0 1" />', '<axis xyz="0 0.5 1" />', "leg1_coxa"),
    "a femur about x": ('<axis xyz="0 -1 0" />', '<axis xyz="1 0 0" />', "leg1_femur and leg1_tibia"),
    "a long leg": ('xyz="0.0724 0.0 0.0"', 'xyz="0.1724 0.0 0.0"', "the femur links"),
    "xacro": ("<mass ", '<mass a="${m}" ', "xacro"),
    "two roots": ("</robot>", '<link name="loose" /></robot>', "2 links"),
    "a link that is not there": ('<parent link="base_link" />', '<parent link="nowhere" />', "nowhere"),
    "a link carried twice": (
        'link="leg2_coxa_link" />',
        'link="leg1_coxa_link" />',
        "leg1_coxa_link",
    ),
    "a number that is none": ('xyz="0.0503 0.0 -0.0112"', 'xyz="0.0503 nan -0.0112"', "xyz"),
    "an axis of length 0": ('xyz="0 0 1"', 'xyz="0 0 0"', "axis of length 0"),
    "no XML": ("</robot>", "", "XML"),
}


def refused(folder: Path, text: str) -> str:
    """The message about a URDF."""
    with pytest.raises(InputError) as error:
        imported(folder, text)
    return str(error.value)


@pytest.mark.parametrize("case", CHANGES)
def test_what_is_no_such_robot_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    old, new, named = CHANGES[case]
    text = urdf_of(shipped())
    assert old in text
    message = refused(tmp_path, text.replace(old, new, 1))
    assert named in message
    assert "\n" not in message


def test_another_xml_entities_and_a_missing_file_are_refused(tmp_path: Path) -> None:
    assert "sdf" in refused(tmp_path, "<sdf/>")
    assert "entities" in refused(tmp_path, '<!DOCTYPE a [<!ENTITY b "c">]><robot/>')
    assert "encoding" in refused(tmp_path, '<?xml version="1.0" encoding="nothing"?><robot/>')
    with pytest.raises(InputError, match=r"missing\.urdf"):
        import_robot("missing.urdf")


def test_a_foot_that_nothing_shows_is_a_guess_that_names_the_mesh() -> None:
    made = import_robot(PHANTOMX)
    assert "tibia_l.STL" in made.reasons["links.tibia.end_m"]
    assert "--foot" in made.reasons["links.tibia.end_m"]
    with pytest.raises(InputError, match="forward"):
        import_robot(PHANTOMX, forward="up")
