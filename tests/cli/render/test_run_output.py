"""Results as text, from the object of `hexctl run --json`."""

from typing import Any

import pytest

from hexctl.cli.console import print_result
from hexctl.cli.render.run_output import summary
from hexctl.cli.render.stop_reasons import in_words, link_in_words, why_in_words
from hexctl.wire.zenoh_messages import SERVER_ENDED

OUTCOME: dict[str, Any] = {
    "gait": {"name": "57", "slots": [4, 2, 3, 5, 1, 6], "code": 57},
    "failed_leg": None,
    "failure": None,
    "duration_s": 10.0,
    "distance_m": 1.2,
    "ideal_distance_m": 1.5,
    "deviation_m": {"final": 0.1, "mean": 0.05, "max": 0.1, "signed": -0.1},
    "yaw_change_deg": -3.0,
    "ideal_yaw_change_deg": 0.0,
    "self_rotation_deg": 0.0,
    "status": "ok",
    "stopped": None,
    "clipped_ticks": 0,
    "ticks": 500,
    "overruns": 0,
    "realtime_factor": 20.0,
    "servo_link": None,
    "backend": "sim",
    "robot": "ant",
    "world": "flat",
    "seed": 0,
    "recording": None,
}


def shown(capsys: pytest.CaptureFixture[str], **changes: Any) -> list[str]:
    print_result(*summary({**OUTCOME, **changes}))
    return capsys.readouterr().out.splitlines()


def test_a_walk(capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(capsys) == [
        "ant in world flat",
        "gait       slots 4,2,3,5,1,6, code 57",
        "walked     1.20 m in 10.0 s, 80 % of ideal (1.50 m without slip or soft start)",
        "off line   10.0 cm to the right at the end, 5.0 cm on average",
        "turned     -3.0 degrees",
        "held       nothing",
        "status     ok",
    ]


def test_what_a_walk_cost_is_said_where_it_is_known(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, energy_j=9.42, cost_of_transport=0.801)
    assert "energy     9.4 J mechanical, cost of transport 0.80" in lines
    assert not [line for line in shown(capsys, energy_j=9.42, cost_of_transport=None) if "energy" in line]


def test_a_simulation_whose_sensors_were_far_off_says_where_the_robot_truly_was(
    capsys: pytest.CaptureFixture[str],
) -> None:
    true = {"final": 0.01, "mean": 0.003, "max": 0.01, "signed": 0.01}
    line = "in truth   1.0 cm to the left at the end, 0.3 cm on average (the sensors were wrong)"
    assert line in shown(capsys, true_deviation_m=true)
    unmeasured = {"distance_m": None, "deviation_m": dict.fromkeys(true)}
    assert line.partition(" (")[0] in shown(capsys, true_deviation_m=true, **unmeasured)
    near = {"final": 0.09, "mean": 0.05, "max": 0.1, "signed": -0.09}
    unknown = dict.fromkeys(near)
    for unsaid in (near, unknown, None):
        assert not [line for line in shown(capsys, true_deviation_m=unsaid) if "in truth" in line]


def test_a_walk_that_was_interrupted_says_by_what(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, status="aborted", stopped="requested")
    assert "status     stopped by Ctrl-C" in lines


def test_a_turn_that_rounds_to_nothing_has_no_sign(capsys: pytest.CaptureFixture[str]) -> None:
    assert "turned     0.0 degrees" in shown(capsys, yaw_change_deg=-0.04)


def test_a_robot_that_was_stopped_says_why_and_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(
        capsys,
        backend="zenoh",
        world=None,
        status="aborted",
        stopped="fault: battery",
        failed_leg=5,
        failure="locked",
        clipped_ticks=7,
        servo_link={"received": 90, "lost": 2, "late": 0},
        recording="runs/walk.rrd",
    )
    assert lines[0] == "ant on zenoh, leg 5 locked"
    assert "status     aborted (fault: battery)" in lines
    assert "link       90 messages came; 2 lost" in lines
    assert any(line.startswith("guard      7 commands clipped") for line in lines)
    assert lines[-1].endswith("hexctl estop --clear")
    assert len([line for line in lines if "hexctl " in line]) == 1, "one next command"


def test_a_row_about_trouble_is_only_there_if_there_was_some(capsys: pytest.CaptureFixture[str]) -> None:
    labels = {"guard", "link", "late"}
    calm = shown(capsys, servo_link={"received": 90, "lost": 0})
    assert not labels & {line.split()[0] for line in calm}
    troubled = shown(capsys, servo_link={"lost": 2}, positions_doubted=3, overruns=4)
    assert labels <= {line.split()[0] for line in troubled}


@pytest.mark.parametrize(("status", "colour"), [("ok", "32"), ("no_progress", "33"), ("fell", "31")])
def test_a_status_has_its_colour_on_a_terminal(
    status: str, colour: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    (row,) = [line for line in shown(capsys, status=status) if line.startswith("status")]
    assert f"{colour}m{status.replace('_', ' ')}" in row


def test_a_turn_on_the_spot_is_not_measured_by_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    spot = {
        "distance_m": 0.003,
        "deviation_m": {"final": 0.004, "mean": 0.002, "max": 0.004, "signed": 0.004},
    }
    lines = shown(capsys, ideal_distance_m=0.0, ideal_yaw_change_deg=50.0, yaw_change_deg=37.4, **spot)
    assert "walked     10.0 s on the spot, ended 0.5 cm from the start" in lines
    assert "turned     37.4 degrees, 75 % of ideal (50.0)" in lines
    assert not any(line.startswith("off line") for line in lines)


def test_a_server_that_has_ended_is_started_and_not_cleared() -> None:
    assert why_in_words(f"fault: {SERVER_ENDED}") == " (fault: hexctl serve has ended): start it again"


#: What was lost on the way: nothing.
LOST: dict[str, Any] = {"hold_lost_s": 0.0, "limited_ticks": 0}


@pytest.mark.parametrize(
    ("duration_s", "held", "words"),
    [
        (10.0, {"hold": "heading"}, "10.0 s; its position is not known"),
        (10.0, {"hold": "none", "hold_caveat": "no pose"}, "10.0 s; its position is not known"),
        (10.0, {"hold": "line"}, "10.0 s; its position was not measured at the end"),
        (10.0, {"hold": "none"}, "10.0 s; its position was not measured at the end"),
        (10.0, {"hold": "line", "status": "no_progress"}, "10.0 s; its position did not change"),
        (0.0, {}, "0.0 s; it never set out"),
    ],
)
def test_a_walk_without_a_position(
    duration_s: float, held: dict[str, str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = shown(capsys, distance_m=None, yaw_change_deg=None, duration_s=duration_s, **LOST | held)
    assert f"walked     {words}" in lines
    assert not any(line.startswith(("off line", "turned")) for line in lines)


def test_a_recording_is_named_with_the_command_that_shows_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(capsys, recording="runs/my walk.rrd")[-2:] == [
        "recording  runs/my walk.rrd",
        "next: hexctl view 'runs/my walk.rrd'",
    ]


def test_counts_in_words() -> None:
    assert in_words({"late": 2, "stale_owner": 1, "other": 0}) == "2 late, 1 stale owner"
    assert link_in_words({"received": 5, "lost": 0}) == "5 messages came; none lost"
    assert link_in_words(None) == ""


def test_legs_that_healed_have_a_word_of_their_own(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, events=["2:limp@8", "5:missing@14", "2@18"])
    assert "failed     leg 2 limp at 8 s, leg 5 missing at 14 s" in lines
    assert "healed     leg 2 at 18 s" in lines
    assert [line.split()[0] for line in lines].count("detected") == 1
