"""`hexctl check`, `robot`, `gaits` and `worlds`: robot files and their meshes."""

from pathlib import Path
from typing import Any

import pytest

from hexctl.backends.sim.world import load_world
from hexctl.gait.gait import make_gait
from hexctl.recording import paths
from hexctl.robot.configs import config_names
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot
from tests.backends.mavlink.boards import fitting_file
from tests.cli.conftest import Call
from tests.recording.conftest import ReadBack
from tests.robot.meshmaking import stl_box
from tests.robots import edited_file, put, shipped, with_ids


def test_the_demand_of_the_papers_robot(call: Call) -> None:
    """The excursions and speeds derived from the paper's numbers (heading 0)."""
    report = call("check ant --heading 0 --json").json
    rows = report["joints"].values()
    assert max(row["highest_deg"] for row in rows) == pytest.approx(26.3, abs=0.1)
    femur, tibia = report["joints"]["leg1_femur"], report["joints"]["leg1_tibia"]
    assert (femur["lowest_deg"], femur["highest_deg"]) == pytest.approx((-6.4, 21.5), abs=0.1)
    assert (tibia["lowest_deg"], tibia["highest_deg"]) == pytest.approx((-113.8, -54.5), abs=0.1)
    assert tibia["peak_speed_deg_s"] == pytest.approx(415, abs=3)
    assert report["speed_holds"]
    assert report["max_pace_hz"] > 0.9


def test_the_verdict_is_first_in_a_short_answer_and_the_joints_are_verbose(call: Call) -> None:
    lines = call("check ant").out.splitlines()
    assert lines[0].startswith("ant can walk this gait")
    assert len(lines) <= 12
    assert max(map(len, lines)) <= 80
    assert not [line for line in lines if "leg6_tibia" in line]
    verbose = call("check ant --verbose").out.splitlines()
    assert verbose[0] == lines[0]
    assert set(lines[:-1]) < set(verbose)
    assert [line for line in verbose if line.startswith("leg6_tibia")]


def test_assumed_limits_and_every_verdict_are_in_a_short_answer(tmp_path: Path, call: Call) -> None:
    unknown = ["joints.femur.max_torque_nm", "joints.tibia.max_speed_deg_s"]
    lines = call("check", str(edited_file(tmp_path, put("unknown", unknown)))).out.splitlines()
    assert lines[1].startswith("torque and speed of joints are assumed (`unknown` in the file)")
    verdicts = {"reach", "range", "speed", "torque", "legs", "sag", "heat"}
    assert verdicts <= {line.partition(":")[0] for line in lines}


def test_a_joint_out_of_range_is_named(tmp_path: Path, call: Call) -> None:
    path = edited_file(tmp_path, put("joints", "coxa", "min_deg", -10), put("joints", "coxa", "max_deg", 10))
    assert "leg1_coxa" in call("check", str(path), "--json", code=2).json["joints_out_of_range"]


@pytest.mark.parametrize(
    ("edit", "found"),
    [
        ({"driver": "feetech"}, {"joints_beyond_counts": 0, "joints_beyond_travel": 0}),
        (
            {"driver": "feetech", "tibia": {"min_count": 1000}, "leg2_coxa": {"max_count": 2100}},
            {"joints_beyond_counts": 7, "joints_beyond_travel": 0},
        ),
        (
            {"driver": "feetech", "femur": {"offset_deg": 100}},
            {"joints_beyond_counts": 6, "joints_beyond_travel": 6},
        ),
        (None, {"to_measure": 2}),
        ({"tibia": {"offset_deg": 75}}, {"joints_beyond_pulses": 0, "gait_fits_pulses": True}),
        ({"tibia": {"offset_deg": 60}}, {"joints_beyond_pulses": 6, "gait_fits_pulses": True}),
        ({"tibia": {"offset_deg": 6}}, {"joints_beyond_pulses": 6, "gait_fits_pulses": False}),
    ],
)
def test_whether_ranges_and_gait_fit_the_servos(
    edit: dict[str, Any] | None, found: dict[str, Any], tmp_path: Path, call: Call
) -> None:
    if edit is None:
        path = edited_file(tmp_path, put("unknown", ["body.mass_kg", "joints.tibia"]))
    elif "driver" in edit:
        path = edited_file(tmp_path, put("servos", edit), base="phantomx")
    else:
        path = fitting_file(tmp_path, edit)
    report = call("check", str(path), "--json").json
    for key, count in found.items():
        assert (report[key] if isinstance(count, bool) else len(report[key])) == count


@pytest.mark.parametrize(
    ("driver", "limits"), [("pca9685", ("min_us", "max_us")), ("feetech", ("min_count", "max_count"))]
)
def test_limits_that_exclude_the_stance_are_refused_at_the_joint(
    driver: str, limits: tuple[str, str], tmp_path: Path, call: Call
) -> None:
    """A femur that stands at 33 degrees, with limits of -45 to -5 degrees; also before a board is opened."""
    per_deg, centre = (2000 / 180, 1500) if driver == "pca9685" else (4096 / 360, 2048)
    ends = [round(centre + per_deg * end_deg) for end_deg in (-45, -5)]
    section = {
        "driver": driver,
        "port": str(tmp_path / "none"),
        "leg2_femur": dict(zip(limits, ends, strict=True)),
    }
    path = edited_file(tmp_path, put("servos", with_ids(section)), base="phantomx")
    report = call("check", str(path), "--json", code=2).json
    assert report["joints_without_stance"] == ["leg2_femur"]
    assert any("leg2_femur" in warning for warning in report["warnings"])
    assert "leg2_femur" in call("check", str(path), code=2).out
    for command in ("run", "serve", "drive --page 127.0.0.1:0"):
        asked = [*command.split(), "--robot", str(path), "--backend", driver]
        assert "leg2_femur" in call(*asked, code=2).err


@pytest.mark.slow
def test_which_legs_may_be_lost_is_printed_by_verdict(call: Call) -> None:
    sets = call("check pexod --leg-sets --heading 0 --json").json["leg_sets"]
    assert [len(one["legs"]) for one in sets] == [1] * 6 + [2] * 15 + [3] * 20
    assert {one["verdict"] for one in sets if len(one["legs"]) == 3} == {"no gait"}
    printed = call("check pexod --leg-sets --heading 0").out
    for legs in ("1 leg ", "2 legs", "3 legs"):
        assert f"without {legs}" in printed


PHANTOMX = Path(__file__).parents[1] / "data" / "phantomx_humarobotics.urdf"


def test_a_robot_file_is_made_and_what_to_measure_is_told(tmp_path: Path, call: Call) -> None:
    mine = tmp_path / "mine.yaml"
    arguments = ["robot", "import", str(PHANTOMX), "--foot", "0,0.13,0", "--name", "mine", "-o", str(mine)]
    file, *measure, following = call(*arguments).out.splitlines()
    assert file == str(mine)
    assert any(line.startswith("  body.size_m: ") for line in measure)
    assert following.endswith(f"hexctl check --robot {mine}")
    assert load_robot(mine).name == "mine"
    own = [*arguments[:-3], "pexod", "-o", str(tmp_path / "own.yaml")]
    assert "pexod is also a shipped robot" in call(*own).err
    before = mine.read_text()
    call(*arguments, code=2)
    assert mine.read_text() == before


def test_what_is_wrong_is_told_in_one_line(tmp_path: Path, call: Call) -> None:
    urdf, mine = tmp_path / "ant.urdf", str(tmp_path / "mine.yaml")
    urdf.write_text(urdf_of(shipped()))
    for arguments, named in (
        ([str(urdf), "-o", mine, "--foot", "a,b,nan"], "--foot"),
        ([str(urdf), "-o", mine, "--forward", "up"], "--forward"),
        ([str(urdf), "-o", str(tmp_path / "mine.txt")], "--output"),
        ([str(urdf), "-o", str(tmp_path / "no" / "mine.yaml")], "--output"),
        ([str(urdf), "-o", mine, "--name", "Not A Name"], "--name"),
        ([mine, "-o", mine], mine),
    ):
        assert call("robot import", *arguments, code=2).line.startswith(f"hexctl: {named}: ")
    assert [path.name for path in tmp_path.iterdir()] == ["ant.urdf"]


def test_shipped_robots_are_listed_and_copied(tmp_path: Path, call: Call) -> None:
    names = call("robot list --json").json
    assert set(names) == set(config_names("robots"))
    mine = tmp_path / "mine.yaml"
    call("robot copy Pexod", str(mine))
    assert "FILE: " in call("robot copy Pexod", str(mine), code=2).err, "nothing is replaced"
    assert load_robot(mine).fingerprint == load_robot("pexod").fingerprint
    call("robot copy mars", str(tmp_path / "other.yaml"), code=2)
    assert not (tmp_path / "other.yaml").exists()


def test_names_of_gaits_and_worlds_are_those_that_options_take(call: Call) -> None:
    for name, slots in call("gaits --json").json.items():
        assert list(make_gait(shipped(), name).slots) == slots
    for name, text in call("worlds --json").json.items():
        assert load_world(name.replace("NUMBER", "3")) is not None
        assert text.endswith(".")


@pytest.fixture
def robot_file(tmp_path: Path) -> Path:
    (tmp_path / "trunk.stl").write_bytes(stl_box())
    return edited_file(tmp_path, put("meshes", {"body": {"file": "trunk.stl", "scale": 0.2}}))


def drawn(path: Path) -> bytes:
    """The mesh that a recording shows as the trunk."""
    return bytes(ReadBack(path).values(f"/{paths.BODY}", "Asset3D:blob")[0][0])


@pytest.mark.slow
def test_a_run_and_a_trial_show_them(call: Call, robot_file: Path, tmp_path: Path) -> None:
    run = ["run", "--robot", str(robot_file), "--duration", "0.5", "--record", "walk.rrd", "--json"]
    call(*run)
    assert drawn(tmp_path / "walk.rrd") == stl_box()
    adapt = ["adapt", "--robot", str(robot_file), "--failed-leg", "5", "--duration", "0.5", "--json"]
    call(*adapt, "--budget", "1", "--optimizer", "random")
    (trial,) = (tmp_path / "runs").glob("*/trial-001.rrd")
    assert drawn(trial) == stl_box()
