"""`hexctl.run` and `hexctl.diagnose`: one call, on any backend, recorded, without printing anything."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexctl
from hexctl.backends.base import ServosWrapper
from hexctl.backends.mock import MockServos
from hexctl.backends.registry import make_servos
from hexctl.backends.sim.servos import SimClock
from hexctl.backends.sim.world import World
from hexctl.control.monitor.recovery import Recovery, Response
from hexctl.control.trial_result import TrialResult
from hexctl.errors import HexctlError, InputError
from hexctl.export.lerobot import task_of
from hexctl.export.recordings import title_of
from hexctl.gait.gait import make_gait
from hexctl.recording.recorded_trial import read_trial
from hexctl.robot.failure import Failure, FailureEvent
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.robot.sensors import SENSORS
from hexctl.runs.run import Run, run
from hexctl.runs.run_spec import RunSpec, spec_of
from hexctl.runs.walk_plan import plan_walk
from hexctl.types import FloatArray, RobotState
from tests.control.posed import PosedMock
from tests.robots import shipped


@pytest.mark.slow
def test_names_and_objects_give_the_same_walk(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    robot, folder = load_robot("ant"), tmp_path / "made" / "here"
    short: dict[str, Any] = {"duration_s": 1.5, "record_folder": folder}
    by_name = run(gait="wave", pace_hz=0.8, world="slippery", **short)
    gait = make_gait(robot, "wave", pace_hz=0.8)
    by_object = run(RunSpec(robot=robot, gait=gait, world=World(friction=0.3), **short))
    assert by_name.trial.status == "ok"
    again = run(RunSpec(gait="wave", pace_hz=0.8, world="slippery", **short))
    assert again.trial.to_dict() == by_name.trial.to_dict()
    assert by_object.outcome["gait"]["slots"] == by_name.outcome["gait"]["slots"]
    assert by_object.outcome["world"] == "custom"
    assert capfd.readouterr() == ("", "")
    recordings = [one.recording for one in (by_name, by_object, again)]
    assert len(set(recordings)) == 3
    assert set(recordings) == set(folder.iterdir())
    assert all(path.suffix == ".rrd" for path in folder.iterdir())
    assert ["_ant_wave" in str(path) for path in recordings] == [True, False, True]


def test_a_simulation_measures_what_the_robot_does_unless_asked_for_more() -> None:
    plain = run(robot="freenove-big", duration_s=1.5, record=False).outcome
    assert plain["sensors"] == plain["sensors_simulated_only"] == []
    assert (plain["distance_m"], plain["hold"], plain["energy_j"]) == (None, "none", None)
    assert plain["true_distance_m"] > 0
    more = run(robot="freenove-big", duration_s=1.5, record=False, all_sensors=True).outcome
    assert set(more["sensors"]) == set(more["sensors_simulated_only"]) == set(SENSORS)
    assert more["distance_m"] == pytest.approx(more["true_distance_m"])
    with pytest.raises(InputError, match=r"all[-_]sensors"):
        run(robot="freenove-big", backend="mock", all_sensors=True, record=False)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "noticed"), [("freenove-big", False), ("jethexa", True), ("lukas", True)])
def test_a_simulated_kit_notices_what_its_servos_show(name: str, noticed: bool) -> None:
    walk: dict[str, Any] = {"robot": name, "failure": ["5:locked@4"], "duration_s": 9.0, "record": False}
    assert bool(run(**walk).outcome["noticed"]) == noticed
    assert [each["leg"] for each in run(**walk, all_sensors=True).outcome["noticed"]][:1] == [5]


def test_a_stop_from_the_start_moves_nothing_and_leaves_no_recording(tmp_path: Path) -> None:
    done = run(stop_requested=lambda: True, record=tmp_path / "walk.rrd")
    assert (done.trial.status, done.trial.stopped, len(done.log)) == ("aborted", "requested", 0)
    assert (done.recording, done.outcome["recording"], done.recording_error) == (None, None, None)
    assert list(tmp_path.iterdir()) == []


def crouch(step: int, _state: RobotState) -> FloatArray:
    """Lifts all femurs slowly."""
    angles_rad = shipped().stance_angles_rad.copy()
    angles_rad[1::3] += min(0.2, 0.002 * step)
    return angles_rad


@pytest.mark.parametrize(("gait", "title"), [({}, "ant crouch"), ({"gait": "wave"}, "ant crouch wave")])
def test_a_recording_of_a_custom_controller_has_its_name(
    gait: dict[str, Any], title: str, tmp_path: Path
) -> None:
    done = run(controller=crouch, record_folder=tmp_path, duration_s=0.4, **gait)
    assert done.recording is not None
    assert done.recording.stem.endswith(title.replace("ant ", "ant_").replace(" ", "-"))
    properties = read_trial(done.recording).properties
    assert (properties["title"], properties["controller"]) == (title, "crouch")
    assert ("gait" in properties) == bool(gait)
    assert (done.outcome["gait"] or {}).get("name") == gait.get("gait")
    assert TrialResult.from_dict(done.trial.to_dict()).controller == "crouch"


@pytest.mark.parametrize(
    ("options", "task"),
    [
        ({}, "walk ahead"),
        ({"heading_rad": -0.5 * np.pi}, "walk at -90 degrees"),
        (
            {"turn_rate_rad_s": np.radians(20), "pace_hz": 0.5},
            "turn left on the spot at 20 degrees/s, at 0.5 Hz",
        ),
        (
            {"turn_rate_rad_s": -0.1, "heading_rad": 0.0, "then": ("wave@0.2",)},
            "walk ahead and turn right at 5.72958 degrees/s, then 4,5,6,3,2,1@0.2",
        ),
    ],
)
def test_all_texts_of_a_walk_name_its_task(options: dict[str, Any], task: str, tmp_path: Path) -> None:
    done = run(backend="mock", duration_s=0.3, gait="tripod", record=tmp_path / "walk.rrd", **options)
    trial = read_trial(tmp_path / "walk.rrd")
    assert done.outcome["task"] == trial.properties["task"] == task
    title = "ant tripod" if task == "walk ahead" else f"ant tripod, {task}"
    assert title_of(trial) == title
    assert task_of(trial) == (title if task in title else f"{task} with {title}")


def test_a_run_walks_only_while_connected() -> None:
    with pytest.raises(InputError, match="connected"):
        Run(RunSpec()).walk()
    with pytest.raises(InputError, match="gait"):
        run(RunSpec(), gait="tripod")


def test_an_option_sums_up_what_failed_before_and_what_fails_later() -> None:
    spec = RunSpec(failed_leg=2, failure=["5:limp", "3:stuck:coxa@8"], heal=["3@9"])
    assert [str(one) for one in spec.failures] == ["locked", "limp"]
    assert [str(event) for event in spec.events] == ["3:stuck:coxa@8", "3@9"]
    assert replace(spec, seed=1).failures == spec.failures
    for options in ({"failed_leg": "2"}, {"failure": "2"}, {"failure": ["2:locked"]}):
        assert RunSpec(**options) == RunSpec(failed_leg=2)


@pytest.mark.parametrize(
    ("options", "rotation"),
    [
        ({"gait": "auto"}, "none"),
        ({"gait": "auto", "hold": "heading"}, "rear"),
        ({"gait": "auto", "hold": "none"}, "rear"),
        ({"gait": "auto", "turn_rate_rad_s": 0.1}, "rear"),
        ({"gait": "demo"}, "rear"),
        ({"gait": "auto", "self_rotation": "front"}, "front"),
    ],
)
def test_a_failed_leg_is_turned_away_where_that_helps(options: dict[str, Any], rotation: str) -> None:
    spec = RunSpec(failure=Failure(leg=2), **options)
    assert Run(spec).plan.self_rotation == rotation


class YawMock(PosedMock):
    """A robot that knows only its yaw."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.position_world = None


class PositionMock(YawMock):
    """A robot that reports its position only at the fifth reading."""

    reads = 0

    def read(self) -> RobotState:
        self.reads += 1
        if self.reads > 4:
            self.position_world = np.zeros(3)
        return super().read()


@pytest.fixture
def _position_comes_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.runs.run.POSITION_COMES_S", 0.2)


@pytest.mark.usefixtures("_position_comes_soon")
@pytest.mark.parametrize(("kit", "rotation"), [("PositionMock", "none"), ("YawMock", "rear")])
def test_only_without_a_position_a_failed_leg_is_turned_to_the_rear(kit: str, rotation: str) -> None:
    with Run(RunSpec(failure=Failure(leg=2), gait="auto", backend=f"{__name__}:{kit}")) as connected:
        assert connected.plan.self_rotation == rotation
        gait = connected.plan.gait
    assert (gait.posture.body_raise > 0) == (rotation == "none"), "the gait is the one for that direction"


@pytest.mark.usefixtures("_position_comes_soon")
def test_a_result_says_that_the_position_is_missing() -> None:
    spec = RunSpec(
        failure=Failure(leg=4),
        gait="auto",
        heading_rad=math.remainder(shipped().mount_yaws_rad[3] - math.pi, math.tau),
        backend=f"{__name__}:YawMock",
        duration_s=0.5,
    )
    with Run(spec) as connected:
        assert connected.plan.self_rotation == "rear"
        result = connected.walk().trial
    assert result.hold == "heading"
    assert result.hold_caveat is not None
    assert "position" in result.hold_caveat


class WarningServos(ServosWrapper):
    """Servos of which one does not answer."""

    def read(self) -> RobotState:
        return replace(super().read(), warnings=("mute: leg 5 coxa (id 13)",))


class TestFailuresInMidWalk:
    """What the world breaks, what the walk notices, and what it does about it."""

    def test_the_result_tells_them_apart(self) -> None:
        done = run(gait="tripod", duration_s=6.0, failure="5:locked@3")
        assert done.outcome["events"] == ["5:locked@3"]
        assert done.outcome["failed_leg"] is None
        (noticed,) = done.outcome["noticed"]
        assert (noticed["leg"], noticed["kind"]) == (5, "locked")
        assert 3 < noticed["at_s"] < 4.2
        assert noticed["did"].startswith("changed to slots")
        assert TrialResult.from_dict(done.trial.to_dict()).noticed == done.trial.noticed
        texts = [text for _, text in done.log.notes]
        assert [text.partition(":")[0] for text in texts] == ["noticed", "recovery"]
        walk = done.log.rows_of("walk").start
        assert {row - walk for row, _ in done.log.notes} == {round(50 * noticed["at_s"])}
        changes = [(change.by, change.row - walk) for change in done.log.leg_changes if change.failures]
        assert changes == [("world", 151), ("belief", round(50 * noticed["at_s"]))]

    def test_warnings_of_servos_are_in_the_result_and_may_explain_a_stop(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("hexctl.runs.run.make_servos", lambda *given: WarningServos(make_servos(*given)))
        done = run(gait="tripod", duration_s=6.0, failure="5:locked@1", recovery="stop")
        (warning,) = done.outcome["warnings"]
        assert done.outcome["stopped"] == f"leg 5 locked; {warning}"
        assert done.log.notes[0] == (0, f"servos: {warning}"), "which are the events of a recording"
        assert TrialResult.from_dict(done.trial.to_dict()).warnings == (warning,)

    def test_what_the_world_lets_fail_is_told_as_well(self) -> None:
        world = World(failures=("2:limp@1", "4:limp@9"))
        with Run(RunSpec(gait="tripod", duration_s=2.0, failure="5:locked@0.5", world=world)) as late:
            assert late.notes == ("4:limp@9 of the world changes nothing: the end is at 2 s",)
            assert late.walk().outcome["events"] == ["5:locked@0.5", "2:limp@1"], "not those after its end"
        with Run(RunSpec(gait="tripod", duration_s=10.0, world=world)) as whole:
            assert whole.notes == ()

    def test_a_leg_heals_that_failed_before_the_walk_or_in_its_world(self) -> None:
        heals = {"gait": "tripod", "duration_s": 2.0, "heal": ["5@1.5"]}
        for failing in ({"failure": Failure(leg=5)}, {"world": World(failures=("5:limp@1",))}):
            with Run(RunSpec(**heals, **failing)) as connected:  # type: ignore[arg-type]
                assert connected.notes == ()
        with pytest.raises(InputError, match="leg 5 is whole"), Run(RunSpec(**heals)):  # type: ignore[arg-type]
            pass

    def test_a_simulation_may_be_asked_to_walk_on(self) -> None:
        done = run(gait="tripod", duration_s=3.0, failure="5:locked@1", recovery="walk-on")
        assert done.trial.status == "ok"
        assert [each.did for each in done.trial.noticed] == ["walked on"]

    def test_a_recovery_of_ones_own(self) -> None:
        class Once(Recovery):
            def respond(self, *_args: object) -> Response:
                return Response(stop=True)

        done = run(gait="tripod", duration_s=3.0, failure="5:locked@1", recovery=Once())
        assert done.trial.status == "aborted"


def test_several_legs_fail_from_the_start() -> None:
    done = run(failure=["5:limp", "4:missing"], gait="auto", duration_s=6.0, self_rotation="none")
    assert done.outcome["failed_leg"] == 4
    assert done.outcome["further_failures"] == {"5": "limp"}
    assert done.outcome["gait"]["phases"] is not None
    assert done.trial.status == "ok"
    assert done.trial.distance_m is not None
    assert done.trial.distance_m > 0.5 * done.trial.ideal_distance_m


def test_a_code_counts_among_the_arrangements_of_the_legs_that_are_left() -> None:
    plan = plan_walk(spec_of({"failed_leg": (2, 5), "gait": "24"}), shipped("ant"))
    assert plan.gait.slots == (6, 2, 4, 3, 5, 1)
    with pytest.raises(InputError, match="gait"):
        plan_walk(spec_of({"failed_leg": (2, 5), "gait": "25"}), shipped("ant"))


def test_a_change_to_auto_without_two_legs_is_a_crawl_and_one_to_a_name_is_none() -> None:
    options = {"failed_leg": (2, 3), "gait": "auto", "then": ("wave@5", "auto@9")}
    wave, crawl = (change.gait for change in plan_walk(spec_of(options), shipped("ant")).changes)
    assert (wave.phases, wave.swing_share) == (None, 1 / 3)
    assert crawl.phases is not None
    assert crawl.swing_share < 1 / 4


@pytest.mark.parametrize(("gait", "then"), [("auto", ()), ("wave", ("auto@5",))])
@pytest.mark.parametrize(("name", "value"), [("swing_share", 0.4), ("stance_shift", (0.02, 0.0))])
def test_auto_without_two_legs_refuses_what_it_finds_by_itself(
    gait: str, then: tuple[str, ...], name: str, value: Any
) -> None:
    options = {"gait": gait, "then": then, name: value}
    with pytest.raises(InputError, match=f"^{name}"):
        plan_walk(spec_of({"failed_leg": (2, 5), **options}), shipped("ant"))
    assert plan_walk(spec_of({"failed_leg": 2, **options}), shipped("ant"))


def test_a_body_that_is_to_stay_down_stays_down_with_a_change_to_auto() -> None:
    options = {"failed_leg": (2, 3), "gait": "wave", "then": ("auto@5",)}
    for given, raised in (({"body_raise": 0.0}, 0.0), ({}, 0.012)):
        (change,) = plan_walk(spec_of({**options, **given}), shipped("ant")).changes
        assert change.gait.posture.body_raise == raised


def test_legs_without_which_a_robot_hardly_walks_are_said_before_it_moves() -> None:
    spec = spec_of({"robot": "pexod", "failure": "1:limp,2:limp", "gait": "auto"})
    with Run(replace(spec, duration_s=0.5)) as connected:
        assert "doubtful" in connected.notes[0]
    with Run(replace(spec, failure=(Failure(leg=1), Failure(leg=4)))) as connected:
        assert not any("doubtful" in note for note in connected.notes)
    with pytest.raises(InputError, match="1,3,5"):
        Run(spec_of({"failed_leg": (1, 3, 5), "gait": "auto"}))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"seed": -1}, "seed"),
        ({"realtime": True, "backend": "mock"}, "realtime"),
        ({"speed": 3}, "speed"),
        ({"gait": "best", "failed_leg": 2}, "gait"),
        ({"gait": make_gait(load_robot(), "demo"), "pace_hz": 1.0}, "pace_hz"),
        ({"record": Path("walk.txt")}, "walk.txt"),
        ({"controller": lambda step, state: crouch(step, state)[:17]}, "controller"),
        ({"failed_leg": "auto"}, "failed_leg"),
        ({"failed_leg": (2, 5), "self_rotation": "rear"}, "2, 5"),
        ({"failure": [FailureEvent(at_s=3.0, leg=5)]}, "failure"),
        ({"heal": [FailureEvent(at_s=3.0, leg=5, failure=Failure(leg=5))]}, "heal"),
        ({"recovery": "run"}, "recovery"),
        ({"recovery": "nowhere:Recovery"}, "recovery"),
        ({"hold": "heading", "trim_rad": 0.1, "turn_rate_rad_s": 0.1}, "trim_rad"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_what_cannot_be_done_is_refused_by_name(options: dict[str, Any], named: str) -> None:
    with pytest.raises(HexctlError, match=named):
        run(**options)


class Echo(MockServos):
    """Servos that echo, ahead of time."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot, clock=SimClock(lambda: None))


ECHO = f"{__name__}:Echo"


def test_a_simulated_leg_is_found_recorded_and_told_in_plain_values(tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.rrd"
    done = hexctl.diagnose(failure="5:limp:femur", record=path)
    assert [str(failure) for failure in done.diagnosis.failures] == ["limp:femur"]
    assert done.trial.status == "ok"
    assert done.recording == path
    assert path.stat().st_size > 10_000
    outcome = json.loads(json.dumps(done.to_dict(), allow_nan=False))
    assert outcome["verdict"] == "leg 5 limp:femur"
    assert outcome["legs"][4]["gains"]["femur"] < 0.3 < outcome["legs"][4]["gains"]["coxa"]
    assert any("left out" in note for note in outcome["notes"])


def test_echoing_servos_are_asked_about_leg_by_leg() -> None:
    asked = []

    def ask(leg: int) -> bool:
        asked.append(leg)
        return leg != 3

    done = hexctl.diagnose(backend=ECHO, ask=ask)
    assert asked == [1, 2, 3, 4, 5, 6]
    assert done.diagnosis.source == done.outcome["source"] == "operator"
    assert done.outcome["verdict"] == "leg 3 unknown"


def test_only_a_simulation_is_told_what_to_break() -> None:
    with pytest.raises(InputError, match="failed_leg"):
        hexctl.diagnose(backend="mock", failed_leg=2)
    with pytest.raises(InputError, match="gait"):
        hexctl.diagnose(gait="wave")
