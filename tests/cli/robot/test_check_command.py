"""`hexctl check` as a user calls it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.backends.sim.world import World
from hexctl.cli.main import exit_code
from hexctl.control.assessment.uncertainty_store import keep_uncertainty, known_uncertainty
from hexctl.robot.configs import config_root
from tests.backends.mavlink.boards import fitting_file
from tests.robots import edited_file, put, shipped


def check_json(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict[str, Any]:
    assert exit_code(["check", *arguments, "--json"]) == code
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_the_demand_of_the_papers_robot(capsys: pytest.CaptureFixture[str]) -> None:
    """The excursions and speeds derived from the paper's numbers (heading 0)."""
    report = check_json(capsys, "ant", "--heading", "0")
    rows = report["joints"].values()
    assert max(row["highest_deg"] for row in rows) == pytest.approx(26.3, abs=0.1)
    femur, tibia = report["joints"]["leg1_femur"], report["joints"]["leg1_tibia"]
    assert (femur["lowest_deg"], femur["highest_deg"]) == pytest.approx((-6.4, 21.5), abs=0.1)
    assert (tibia["lowest_deg"], tibia["highest_deg"]) == pytest.approx((-113.8, -54.5), abs=0.1)
    assert tibia["peak_speed_deg_s"] == pytest.approx(415, abs=3)
    assert report["speed_holds"]
    assert report["max_pace_hz"] > 0.9


@pytest.mark.parametrize("robot", ["ant", "phantomx", "pexod"])
def test_shipped_robots_can_walk_their_own_gait(robot: str, capsys: pytest.CaptureFixture[str]) -> None:
    report = check_json(capsys, "--robot", robot)
    assert report["possible"]
    assert report["feet_stay_apart"]
    assert len(report["joints"]) == 18


@pytest.mark.parametrize("robot", ["ant", "phantomx"])
def test_the_verdict_is_first_in_a_short_answer_and_the_joints_are_verbose(
    robot: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["check", robot]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{robot} can walk this gait")
    assert len(lines) <= 12
    assert max(map(len, lines)) <= 80
    assert not [line for line in lines if "leg6_tibia" in line]
    assert exit_code(["check", robot, "--verbose"]) == 0
    verbose = capsys.readouterr().out.splitlines()
    assert verbose[0] == lines[0]
    assert set(lines[:-1]) < set(verbose)
    assert [line for line in verbose if line.startswith("leg6_tibia")]


@pytest.mark.slow
def test_the_pace_it_names_is_clipped_nowhere(capsys: pytest.CaptureFixture[str]) -> None:
    pace = check_json(capsys, "ant")["max_pace_hz"]
    assert check_json(capsys, "ant", "--pace", f"{pace - 0.001}")["speed_holds"]
    assert not check_json(capsys, "ant", "--pace", f"{pace + 0.01}")["speed_holds"]


@pytest.mark.slow
def test_an_impossible_gait_is_said_with_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    report = check_json(capsys, "ant", "--amplitude", "0.5", code=2)
    assert not report["possible"]
    assert report["unreachable_legs"]
    assert exit_code(["check", "ant", "--amplitude", "0.5"]) == 2
    assert "out of reach for leg" in capsys.readouterr().out


def test_a_joint_out_of_range_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "stiff.yaml"
    text = (config_root() / "robots" / "ant.yaml").read_text()
    path.write_text(text.replace("min_deg: -60, max_deg: 60", "min_deg: -10, max_deg: 10"))
    report = check_json(capsys, str(path), code=2)
    assert "leg1_coxa" in report["joints_out_of_range"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset_deg", "beyond", "gait_fits", "words"),
    [
        (75, 0, True, "servos: every range fits into the pulse limits"),
        (60, 6, True, "a board clips it, this gait is not"),
        (0, 6, False, "a board clips it, this gait too"),
    ],
)
def test_whether_ranges_and_gait_fit_into_the_pulses(
    offset_deg: float,
    beyond: int,
    gait_fits: bool,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = str(fitting_file(tmp_path, {"tibia": {"offset_deg": offset_deg}}))
    assert exit_code(["check", path, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert len(report["joints_beyond_pulses"]) == beyond
    assert report["gait_fits_pulses"] == gait_fits
    assert len(report["pulses_us"]) == 18
    assert exit_code(["check", path]) == 0
    assert words in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("servos", "beyond", "travel", "words"),
    [
        ({}, 0, 0, "servos: every range fits into the counts of its servo (min_count, max_count)"),
        (
            {"tibia": {"min_count": 1900}, "leg2_coxa": {"max_count": 2100}},
            7,
            0,
            "servos: range beyond the min_count, max_count for leg2_coxa, all tibiae; the bus clips it",
        ),
        (
            {"femur": {"offset_deg": 100}},
            6,
            6,
            "servos: range beyond all counts that the servo has for all femurs; the bus clips it",
        ),
    ],
)
def test_whether_ranges_fit_into_the_counts(
    servos: dict[str, Any],
    beyond: int,
    travel: int,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = str(edited_file(tmp_path, put("servos", {"driver": "feetech", **servos}), base="phantomx"))
    assert exit_code(["check", path, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert len(report["joints_beyond_counts"]) == beyond
    assert len(report["joints_beyond_travel"]) == travel
    assert len(report["counts"]) == 18
    assert "pulses_us" not in report
    assert (report["driver"], report["to_measure"]) == ("feetech", [])
    assert exit_code(["check", path]) == 0
    printed = capsys.readouterr().out
    assert words in printed
    assert "to measure" not in printed


@pytest.mark.slow
def test_what_is_unknown_is_to_be_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(edited_file(tmp_path, put("unknown", ["body.mass_kg", "joints.tibia"])))
    assert exit_code(["check", path, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["to_measure"] == ["body.mass_kg", "joints.tibia"]
    assert exit_code(["check", path]) == 0
    assert "to measure: body.mass_kg, joints.tibia; the values in the file" in capsys.readouterr().out


def test_a_bad_servo_map_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(fitting_file(tmp_path, {"leg1_coxa": {"channel": 2}}))
    assert exit_code(["check", path]) == 2
    assert "channel 2 for leg1_coxa and leg1_femur" in capsys.readouterr().err


@pytest.mark.slow
def test_servos_too_weak_for_the_weight_are_impossible(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "weak.yaml"
    text = (config_root() / "robots" / "ant.yaml").read_text()
    path.write_text(text.replace("max_torque_nm: 2.5", "max_torque_nm: 0.05"))
    report = check_json(capsys, str(path), code=2)
    assert not report["possible"]
    assert report["load_capacity"] < 1
    femur = report["joints"]["leg1_femur"]
    assert femur["static_torque_nm"] > femur["max_torque_nm"]
    assert exit_code(["check", str(path)]) == 2
    printed = capsys.readouterr().out
    assert "too weak" in printed
    assert printed.splitlines()[0].endswith("cannot walk this gait")


def test_a_heavy_robot_on_soft_servos_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "heavy.yaml"
    text = (config_root() / "robots" / "phantomx.yaml").read_text()
    path.write_text(text.replace("mass_kg: 1.522", "mass_kg: 8.0"))
    report = check_json(capsys, str(path))
    assert report["sag_deg"] > 8
    assert report["dragging_legs"]
    (soft,) = [warning for warning in report["warnings"] if warning.startswith("soft")]
    assert "such robots that were simulated" in soft
    assert report["possible"]
    assert report["doubtful"]
    assert exit_code(["check", str(path)]) == 0
    assert "may not be able to walk this gait, see the warnings" in capsys.readouterr().out


@pytest.mark.slow
def test_legs_that_cross_leave_open_whether_the_robot_walks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (config_root() / "robots" / "pexod.yaml").read_text()
    for x_m, nearer_m in (("0.11", "0.03"), ("-0.01", "0.0"), ("-0.13", "-0.03")):
        text = text.replace(f"position_m: [{x_m},", f"position_m: [{nearer_m},")
    path = tmp_path / "crowded.yaml"
    path.write_text(text)
    report = check_json(capsys, str(path), "--gait", "demo")
    assert report["legs_cross"]
    assert report["doubtful"]
    percent = f"cross for {100 * report['legs_cross_share']:.0f} % of the cycle"
    assert exit_code(["check", str(path), "--gait", "demo"]) == 0
    printed = capsys.readouterr().out
    assert printed.count(percent) == 1
    one, other = report["nearest_legs"]
    overlap_mm = -1000 * report["least_leg_clearance_m"]
    assert f"legs: {one} and {other} overlap by {overlap_mm:.0f} mm" in printed
    assert "such robots that were simulated with solid legs" in printed
    assert "may not be able to walk this gait, see the warnings" in printed
    assert exit_code(["check", "pexod"]) == 0
    assert "may not" not in capsys.readouterr().out


@pytest.mark.slow
def test_the_simulations_own_uncertainty_is_measured_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert known_uncertainty("pexod", duration_s=0.5) is None
    physics = check_json(capsys, "pexod", "--physics", "--duration", "0.5")["physics"]
    found = known_uncertainty("pexod", duration_s=0.5)
    assert found is not None
    assert found.to_dict() == physics
    assert (tmp_path / "runs" / "uncertainty.yaml").is_file()
    keep_uncertainty(shipped("pexod"), World(), replace(found, walks=100), folder=tmp_path / "runs")
    assert exit_code(["check", "pexod", "--physics", "--duration", "0.5"]) == 0
    printed = capsys.readouterr()
    assert "cm of 100 walks is known already" in printed.err
    assert "rms of 20 walks, " in printed.out
    assert "cm with 95 % confidence" in printed.out
    kept = known_uncertainty("pexod", duration_s=0.5)
    assert kept is not None
    assert kept.walks == 100


def test_where_and_how_long_belong_to_the_measurement(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["check", "ant", "--duration", "5"]) == 2
    assert "--duration: got 5; allowed: with --physics" in capsys.readouterr().err
    assert exit_code(["check", "ant", "--world", "flat"]) == 2
    assert "--world: got flat; allowed: with --physics" in capsys.readouterr().err


@pytest.mark.slow
def test_which_legs_may_be_lost_is_printed_by_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    sets = check_json(capsys, "pexod", "--leg-sets", "--heading", "0")["leg_sets"]
    assert [len(one["legs"]) for one in sets] == [1] * 6 + [2] * 15 + [3] * 20
    assert {one["verdict"] for one in sets if len(one["legs"]) == 3} == {"no gait"}
    assert exit_code(["check", "pexod", "--leg-sets", "--heading", "0"]) == 0
    printed = capsys.readouterr().out
    assert "without 1 leg   walks: any of 6; margin -0.06 to" in printed
    assert "without 3 legs  no gait: any of 20" in printed
    assert "doubtful        leans further than robots that walked" in printed


@pytest.mark.slow
def test_the_envelope_says_what_its_figures_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["check", "--envelope"]) == 0
    out = capsys.readouterr().out
    assert "envelope: greatest velocity commands" in out
    assert "0.178 m/s" in out
    assert exit_code(["check", "--help"]) == 0
    assert "best" not in capsys.readouterr().out
