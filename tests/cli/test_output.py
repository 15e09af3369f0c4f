"""Walks and sessions as text: their figures, and the next command."""

import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import pytest

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.runner import LegFailedError, without_count
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import BaselineRecord, ConfirmationRecord, TrialRecord
from hexctl.cli.console import print_result
from hexctl.cli.render.run_output import summary
from hexctl.cli.render.session_summary import after_stop
from hexctl.cli.render.session_tables import opening_lines, walk_line
from hexctl.options import options_of
from hexctl.robot.failure import Failure, NoticedFailure
from hexctl.runs.run_spec import RunSpec
from tests.adapt.walking import closing_lines, result_of

WALK: dict[str, Any] = {
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
    "warnings": [],
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
SPOT = {
    "distance_m": 0.003,
    "deviation_m": {"final": 0.004, "mean": 0.002, "max": 0.004, "signed": 0.004},
    "ideal_distance_m": 0.0,
    "ideal_yaw_change_deg": 50.0,
    "yaw_change_deg": 37.4,
}
#: A walk whose position is not known at its end.
UNSEEN = {"distance_m": None, "yaw_change_deg": None, "hold_lost_s": 0.0, "limited_ticks": 0}
LOST = {"received": 90, "lost": 2, "late": 0}
NOTICED = NoticedFailure(at_s=3.4, failure=Failure(leg=5, kind="limp"), evidence="following", did="stopped")
LEG_5 = {"noticed": [NOTICED.to_dict()]}
HOT = ["hot, 72 degrees C: leg 5 femur (id 15)"]
STEPS = {"height": "0.2", "turn": "-0.174533", "heading": "0.523599", "gait": "wave"}
EVENTS = ["2:limp@8", "5:missing@14", "2@18"]


def shown(capsys: pytest.CaptureFixture[str], **changes: Any) -> dict[str, str]:
    """The rows of a walk, by label."""
    print_result(*summary({**WALK, **changes}))
    lines = capsys.readouterr().out.splitlines()
    return {line[:11].strip(): line[11:].strip() for line in lines}


@pytest.mark.parametrize(
    ("changes", "label", "text"),
    [
        ({}, "gait", "slots 4,2,3,5,1,6, code 57"),
        ({}, "walked", "1.20 m in 10.0 s, 80 % of ideal (1.50 m"),
        ({}, "off line", "10.0 cm to the right at the end, 5.0 cm on average"),
        ({"yaw_change_deg": -0.04}, "turned", "0.0 degrees"),
        ({"status": "aborted", "stopped": "requested"}, "status", "stopped by Ctrl-C"),
        ({"status": "aborted", "stopped": "fault: battery"}, "status", "aborted (fault: battery)"),
        ({"servo_link": LOST}, "link", "90 messages came; 2 lost"),
        ({"clipped_ticks": 170}, "guard", "170 commands clipped, too fast"),
        ({"clipped_ticks": 9}, "guard", "9 of 500 commands clipped"),
        ({"clipped_ticks": 170, **LEG_5}, "guard", "170 commands clipped"),
        ({"stopped": "leg 5 limp", **LEG_5, "status": "aborted"}, "next: the s", "ame with --recovery glide"),
        ({**LEG_5, "status": "aborted", "warnings": HOT}, "next: let l", "eg 5 femur (id 15) cool down"),
        ({"stopped": "hot: leg 5 femur 72 C", "status": "aborted"}, "next: let l", "eg 5 femur cool down"),
        (SPOT, "walked", "10.0 s on the spot, ended 0.5 cm from the start"),
        ({**UNSEEN, "hold": "line"}, "walked", "10.0 s; its position is not known"),
        ({"events": EVENTS}, "failed", "leg 2 limp at 8 s, leg 5 missing at 14 s"),
        ({"events": EVENTS}, "healed", "leg 2 at 18 s"),
        ({"recording": "runs/my walk.rrd"}, "next: hexct", "l view 'runs/my walk.rrd'"),
        (
            {"status": "no_progress", "recording": None, "options": STEPS},
            *("next: hexct", "l check ant --gait wave --heading 30 --turn -10 --height 0.2"),
        ),
        ({"task": "walk at 30 degrees"}, "task", "walk at 30 degrees"),
    ],
    ids=str,
)
def test_a_row_of_a_walk(
    changes: dict[str, Any], label: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shows = shown(capsys, **changes)[label]
    assert shows.startswith(text)
    assert ("--pace" in shows) == ("too fast" in text)


@pytest.mark.parametrize(
    ("changes", "labels"),
    [
        ({"servo_link": {"received": 90, "lost": 0}}, ["guard", "link", "late"]),
        ({"energy_j": 9.42, "cost_of_transport": None}, ["energy"]),
        ({**SPOT, "task": "walk ahead"}, ["off line", "task"]),
        ({**UNSEEN, "hold": "line"}, ["off line", "turned"]),
    ],
    ids=str,
)
def test_a_row_is_only_there_if_there_is_something_to_say(
    changes: dict[str, Any], labels: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert not shown(capsys, **changes).keys() & labels


OUTCOME = {
    "status": "ok",
    "duration_s": 30.0,
    "distance_m": 3.2,
    "deviation_m": {"signed": 0.006},
    "yaw_change_deg": 0.0,
    "clipped_ticks": 0,
    "trim_deg": None,
    "turn_trim_deg_s": None,
}
WALKED: dict[str, Any] = {"path_m": [], "recording": None}


def session(tripod: float | None = None, **changes: Any) -> Session:
    """A session with one trial, 6 mm off the line, and a tripod before it that is so far off."""
    spec = SessionSpec(
        **{"failed_leg": 5, "optimizer": "bayes", "prior": "x.npz", "target_m": 0.025, **changes}
    )
    slots = (1, 2, 3, 4, 0, 5)
    trial = TrialRecord(index=1, code=17, slots=slots, score=0.006, outcome=OUTCOME, **WALKED)
    made = Session(name="s", spec=spec, created="2026-01-01", trials=[trial], ended="budget")
    if tripod is not None:
        walk = BaselineRecord(
            gait="tripod", code=None, slots=(0,) * 6, score=tripod, outcome=OUTCOME, **WALKED
        )
        made.baseline.append(walk)
    return made


def closing(made: Session, ended: str | None = "budget") -> dict[str, str]:
    """The last lines of a search, by what is before the colon."""
    return {
        line.partition(": ")[0]: line.partition(": ")[2] for line in closing_lines(made, ended).splitlines()
    }


def confirmed(signed_m: float) -> Session:
    made = session(uncertainty_m=0.0213, confirmed_uncertainty_m=0.008)
    walked = {**OUTCOME, "deviation_m": {"signed": signed_m}}
    record = ConfirmationRecord(
        code=17, slots=(1, 2, 3, 4, 0, 5), score=abs(signed_m), outcome=walked, time_step_s=0.0005, **WALKED
    )
    made.confirmations = [record]
    assert str(walk_line(made, record)).endswith("ok at 0.5 ms")
    return made


def repeated() -> Session:
    made = session(optimizer="trim", backend="zenoh", world=None)
    again = {**OUTCOME, "deviation_m": {"signed": -0.004}}
    made.trials += [replace(made.trials[0], index=2, score=0.004, outcome=again, confirms=True)]
    return made


def real() -> Session:
    made = session(backend="zenoh", world=None)
    made.settled_on = {"code": 17, "chance": 0.65, "target_m": 0.025}
    return made


TRIMMED = "--hold none --trim 1.2300 --turn-trim -0.4560 --self-rotation rear"


def trimmed() -> Session:
    made = session(optimizer="trim", hold="none")
    outcome = {**OUTCOME, "trim_deg": 1.23, "turn_trim_deg_s": -0.456}
    made.trials[0] = replace(made.trials[0], outcome=outcome)
    return made


STEERED: dict[str, Any] = {"objective": "speed", "hold": "auto", "self_rotation": "none", "body_raise": 0.012}


@pytest.mark.parametrize(
    ("made", "label", "text"),
    [
        (lambda: session(uncertainty_m=0.0213), "found", "gait 17, trial 1, ends 0.6 cm left"),
        (real, "chance", "65 % that gait 17 ends within 2.5 cm"),
        (repeated, "found", "gait 17, trial 1, ends 0.4 cm right"),
        (repeated, "accuracy", "repeated in trial 2; within 2.5 cm"),
        (lambda: confirmed(-0.002), "found", "gait 17, trial 1, ends 0.2 cm right"),
        (lambda: confirmed(-0.002), "accuracy", "± 0.8 cm by a walk at a time step of 0.5 ms; within 2.5 cm"),
        (lambda: session(tripod=0.1), "without a search", "tripod 10.0 cm; the search gains 9.4 cm"),
        (
            lambda: session(0.05, uncertainty_m=0.0213),
            "without a search",
            "tripod 5.0 cm; not distinguishable from trial 1",
        ),
        (
            lambda: session(**STEERED),
            "walk on with",
            "hexctl run --failed-leg 5 --gait 17 --body-raise 0.012",
        ),
        (trimmed, "walk on with", f"hexctl run --failed-leg 5 --gait 17 {TRIMMED}"),
        (
            lambda: session(hold="none", heading_rad=math.radians(20.0)),
            "walk on with",
            "hexctl run --failed-leg 5 --gait 17 --hold none --heading 20 --self-rotation rear",
        ),
    ],
)
def test_a_line_at_the_end_of_a_search(made: Callable[[], Session], label: str, text: str) -> None:
    assert closing(made())[label].startswith(text)


#: Another value of each option that `hexctl adapt` and `hexctl run` share, as typed.
SHARED: dict[str, tuple[dict[str, Any], str]] = {
    "backend": ({"backend": "zenoh"}, "--backend zenoh"),
    "robot": ({"robot": "phantomx"}, "--robot phantomx"),
    "world": ({"world": "rough"}, "--world rough"),
    "failed-leg": ({"failed_leg": 3}, "--failed-leg 3"),
    "failure": ({"failed_leg": None, "failure": "5:limp"}, "--failure 5:limp"),
    "all-sensors": ({"all_sensors": True}, "--all-sensors"),
    "seed": ({"seed": 3}, "--seed 3"),
    "connect": ({"connect": "tcp/robot:7447"}, "--connect tcp/robot:7447"),
    "port": ({"port": "/dev/ttyUSB0"}, "--port /dev/ttyUSB0"),
    "keys": ({"credentials": "folder"}, "--keys folder"),
    "insecure": ({"insecure": True}, "--insecure"),
    "link": ({"link": "link.yaml"}, "--link link.yaml"),
    "duration": ({"duration_s": 6.0}, "--duration 6"),
    "heading": ({"heading_rad": math.radians(20.0)}, "--heading 20"),
    "hold": ({"hold": "heading"}, "--hold heading"),
    "recovery": ({"recovery": "stop"}, "--recovery stop"),
    "self-rotation": ({"self_rotation": "front"}, "--self-rotation front"),
    "body-raise": ({"body_raise": 0.012}, "--body-raise 0.012"),
}


def test_the_command_to_walk_on_with_has_each_option_that_the_session_shares_with_a_run() -> None:
    names = {field.name for field in fields(SessionSpec)}
    assert {option.flag for option in options_of(RunSpec) if option.name in names} == SHARED.keys()
    for changes, typed in SHARED.values():
        assert typed in closing(session(**changes))["walk on with"]


def test_a_hot_servo_cools_down_before_a_search_continues() -> None:
    failed = NoticedFailure(at_s=4.0, failure=Failure(leg=5), evidence="effort", did="")
    walk = replace(result_of(0.1), noticed=(failed,), warnings=tuple(HOT))
    reason = without_count(walk).stopped
    assert reason == f"leg 5 locked, noticed 4.0 s into it; {HOT[0]}"
    spec = session().spec
    assert after_stop(spec, LegFailedError("", reason, (5,))) == "let its servo cool down, "
    overheated = LegFailedError("", "leg 5 limp; hot: leg 5 femur (id 15)", (5,))
    assert after_stop(spec, overheated) == "let its servo cool down, "
    assert "--failed-leg 2,5" in after_stop(spec, LegFailedError("", "leg 2 limp", (2,)))


def test_nothing_is_said_of_what_is_not_known_or_not_learned() -> None:
    other = session(uncertainty_m=0.0213, objective="scores:heading_lost", objective_unit="rad")
    for made in (session(), other):
        assert "±" not in closing_lines(made, "budget") + "\n".join(opening_lines(made))
    none_yet = replace(session(0.001, uncertainty_m=0.0213), trials=[])
    assert not {"walk on with", "confirmed"} & closing(none_yet, "interrupted").keys()


def test_no_line_of_a_search_is_wider_than_a_terminal() -> None:
    made = session(tripod=0.1, uncertainty_m=0.0213, uncertainty_caveat="measured on the flat world")
    fallen = replace(made.trials[0], outcome={**OUTCOME, "status": "no_progress", "cause": "saturation"})
    shown = [walk_line(made, made.baseline[0]), walk_line(made, fallen), *opening_lines(made)]
    assert max(len(str(line)) for line in (*shown, *closing_lines(made, "budget").splitlines()[:4])) <= 80


def test_a_gait_without_a_search_that_no_trial_is_better_than_is_the_one_to_walk_on_with() -> None:
    def gait_of(made: Session) -> str:
        return closing(made)["walk on with"].partition(" --gait ")[2].partition(" ")[0]

    assert gait_of(session(0.001)) == "tripod"
    assert gait_of(session(0.008)) == "17", "the trial is better"
    assert "up to 40 trials of 30 s" in "".join(opening_lines(session(0.008, budget=40)))
    assert gait_of(session(0.001, uncertainty_m=0.0213)) == "tripod", "not resolved: no search is needed"
    both = session(0.003)
    stable = replace(both.baseline[0], gait="auto", code=42, score=0.002)
    both.baseline.append(stable)
    assert gait_of(both) == "42", "the better one of two; auto by its code"
    both.baseline[1] = replace(stable, code=None, slots=(1, 3, 6, 2, 5, 4))
    assert gait_of(both) == "1,3,6,2,5,4"
    both.trials[0] = replace(both.trials[0], score=INVALID_SCORE, outcome={**OUTCOME, "status": "fell"})
    assert gait_of(both) == "1,3,6,2,5,4", "no trial is valid"
