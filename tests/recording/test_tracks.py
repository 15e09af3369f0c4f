"""What is drawn: robot, floor, gait, ribbon, support, servos, guard, events, failures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.terrain import make_floor
from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trace import PHASES
from hexctl.control.trial import run_trial
from hexctl.gait.foot_trajectory import gait_feet_body
from hexctl.ik.legs import foot_positions_body
from hexctl.ik.support_polygon import centre_of_mass_body, support, to_world
from hexctl.palette import FAILED_COLORS, LINK_COLORS
from hexctl.recording import paths, style
from hexctl.recording.blueprint import make_blueprint
from hexctl.recording.recording import Recording
from hexctl.recording.scene import MAX_VERTICES, make_floor_mesh
from hexctl.robot.failure import Failure
from hexctl.runs.run import RunResult, run
from tests.recording.conftest import ReadBack, Trial, make_plan, write
from tests.robot.meshmaking import glb_box, stl_box
from tests.robots import edited_file, put, shipped

WALK = PHASES.index("walk")


@pytest.fixture(scope="module")
def read(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> ReadBack:
    return ReadBack(write(tmp_path_factory.mktemp("drawn") / "trial.rrd", trial))


def lane(read: ReadBack, path: str, ticks: int) -> list[str]:
    """The state at each tick."""
    at = np.round(read.times_s(f"/{path}", "StateChange:state") * 50).astype(int)
    states = [value[0] for value in read.values(f"/{path}", "StateChange:state")]
    rows = np.searchsorted(at, np.arange(ticks), side="right") - 1
    return [states[row] for row in rows]


def commanded_swing(trial: Trial) -> np.ndarray:
    """Which feet the gait of the walk has in the air at each tick of it, (ticks, 6)."""
    log, plan, robot = trial.log, trial.plan, trial.robot
    ticks = np.count_nonzero(log["phase"] == WALK)
    feet = gait_feet_body(robot, plan.gait, plan.motion(trial.result.turned_rad), np.arange(ticks) * 0.02)
    swing = np.asarray(feet[..., 2] > robot.stance_feet_body[:, 2] + 1e-5)
    swing[:, [leg - 1 for leg in plan.held_legs]] = False
    return swing


def test_the_gait_diagram_says_what_is_commanded_and_what_else_is_felt(read: ReadBack, trial: Trial) -> None:
    """A foot that does something else for a tenth of a second is told, one that rattles is not."""
    log = trial.log
    swing, touching = commanded_swing(trial), log["foot_contacts"][log["phase"] == WALK]
    for leg in range(1, 7):
        drawn = np.array(lane(read, paths.gait_path(leg), len(log)))[log["phase"] == WALK]
        np.testing.assert_array_equal(np.isin(drawn, [style.SWING, style.DRAGS]), swing[:, leg - 1])
        other = (swing == touching)[:, leg - 1]
        for row in range(4, len(other)):
            told = drawn[row] in (style.HANGS, style.DRAGS)
            assert told == other[row - 4 : row + 1].all()


def test_polygon_and_centre_of_gravity_are_those_of_the_measured_robot(read: ReadBack, trial: Trial) -> None:
    log, robot = trial.log, trial.robot
    rows = np.arange(0, len(log), 5)
    pose = log["base_position_world"][rows], log["base_quaternion_world"][rows]
    joints = log["measured_rad"][rows]
    feet = to_world(foot_positions_body(robot, joints), *pose)[..., :2]
    centre = to_world(centre_of_mass_body(robot, joints)[:, np.newaxis], *pose)[:, 0]
    found = support(feet, log["foot_contacts"][rows] > 0, centre[:, :2])
    drawn = np.array(read.values(f"/{paths.POLYGON}", "Mesh3D:vertex_positions"))
    np.testing.assert_allclose(drawn[..., :2], found.corners, atol=1e-3)
    lines = np.array(read.values(f"/{paths.CENTRE}", "LineStrips3D:strips"))[:, 0]
    np.testing.assert_allclose(lines[:, 1], centre, atol=1e-3)
    np.testing.assert_allclose(lines[:, 0, :2], centre[:, :2], atol=1e-3)
    colors = [value[0] for value in read.values(f"/{paths.CENTRE}", "Points3D:colors")]
    steady, unsteady = (style.packed(color) for color in (style.STEADY_COLOR, style.UNSTEADY_COLOR))
    assert colors == [steady if margin > 0 else unsteady for margin in found.margin_m]


def test_clipped_targets_and_missed_ticks_are_marked_and_told(trial: Trial, tmp_path: Path) -> None:
    sent = trial.log["requested_rad"].copy()
    sent[60:63, 4] += 0.01
    times = trial.log["time_s"].copy()
    times[100:] += 0.06
    troubled = trial.with_columns(commanded_rad=sent, time_s=times)
    troubled.log.notes = [(90, "noticed: leg 5 locked")]
    read = ReadBack(write(tmp_path / "troubled.rrd", troubled))
    at = np.round(read.times_s(f"/{paths.GUARD}", "StateChange:state") * 50).astype(int).tolist()
    states = [value[0] for value in read.values(f"/{paths.GUARD}", "StateChange:state")]
    usual, clipped, missed = style.GUARD_STATES
    assert list(zip(at, states, strict=True)) == [
        (0, usual), (60, clipped), (63, usual), (103, missed), (104, usual)
    ]  # fmt: skip
    told = [value[0] for value in read.values(f"/{paths.EVENTS}", "TextLog:text")]
    assert "clipped: leg2_femur" in told
    happened = np.round(read.times_s(f"/{paths.EVENTS}", "TextLog:text") * 50).astype(int).tolist()
    assert (90, "noticed: leg 5 locked") in zip(happened, told, strict=True)
    assert any(text.startswith("missed 3 ticks") for text in told)
    assert [text for text in told if text.endswith("begins")] == [f"{phase} begins" for phase in PHASES]
    assert told[-1] == "trial over, ok"


def test_a_stop_is_marked_with_its_reason(tmp_path: Path) -> None:
    robot = shipped()
    plan = make_plan(robot, duration_s=3.0)
    path = tmp_path / "stopped.rrd"
    with (
        Recording(path, robot, plan, title="stopped") as recording,
        Guard(SimServos(robot)) as guard,
    ):
        log = TickLog()

        def stop_soon() -> bool:
            if len(log) == 80:
                guard.stop("estop")
            return False

        result = run_trial(guard, plan, recorders=(log, recording), stop_requested=stop_soon)
        recording.finish(result, {})
    read = ReadBack(path)
    assert result.status == "aborted"
    assert lane(read, paths.GUARD, len(log))[-1] == style.STOPPED
    assert read.values(f"/{paths.EVENTS}", "TextLog:text")[-1] == ["trial over, aborted: estop"]
    assert read.values(f"/{paths.EVENTS}", "TextLog:level")[-1] == ["ERROR"]


def test_a_robot_that_knows_its_position_alone_is_drawn_on_its_way(
    read: ReadBack, trial: Trial, tmp_path: Path
) -> None:
    without = np.full((len(trial.log), 4), np.nan)
    alone = ReadBack(write(tmp_path / "alone.rrd", trial.with_columns(base_quaternion_world=without)))
    for path, component in (
        (paths.TRAIL, "LineStrips3D:strips"),
        (paths.RIBBON, "Mesh3D:vertex_positions"),
        ("deviation", "Scalars:scalars"),
        (paths.ROBOT, "Transform3D:translation"),
    ):
        drawn = alone.values(f"/{path}", component)
        assert drawn == read.values(f"/{path}", component)
        assert drawn
    assert alone.values(f"/{paths.ROBOT}", "Transform3D:quaternion") == [[[0, 0, 0, 1]]] * len(trial.log)
    assert alone.values(f"/{paths.CENTRE}", "Points3D:positions") == []


BROKEN_S, HEALED_S = 3.0, 6.0


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """A leg goes limp in mid-walk and heals, and the walk recovers both times."""
    broken: dict[str, Any] = {"failure": f"2:limp@{BROKEN_S}", "heal": [f"2@{HEALED_S}"]}
    path = tmp_path_factory.mktemp("failing") / "a.rrd"
    return run(gait="tripod", duration_s=13.0, recovery="glide", record=str(path), **broken)


@pytest.fixture(scope="module")
def failing(walked: RunResult) -> ReadBack:
    assert walked.recording is not None
    return ReadBack(walked.recording)


def timed(failing: ReadBack, path: str, component: str) -> Any:
    """Values with their times in the walk."""
    times = failing.times_s(f"/{path}", component, paths.WALK_TIMELINE)
    return list(zip(times.tolist(), failing.values(f"/{path}", component), strict=True))


@pytest.mark.slow
def test_events_have_the_times_of_the_summary(walked: RunResult, failing: ReadBack) -> None:
    noticed, healed = walked.trial.noticed
    said = {value[0]: time for time, value in timed(failing, paths.EVENTS, "TextLog:text")}
    assert said["world: leg 2 limp"] == pytest.approx(BROKEN_S)
    assert said["world: leg 2 whole again"] == pytest.approx(HEALED_S)
    assert said["noticed: leg 2 limp, by following"] == pytest.approx(noticed.at_s)
    assert said["noticed: leg 2 follows again"] == pytest.approx(healed.at_s)
    assert said[f"recovery: {healed.did}"] == pytest.approx(healed.at_s)
    assert said["walk begins"] == 0


def test_lanes_and_legs_show_what_is_broken_and_what_was_noticed(
    walked: RunResult, failing: ReadBack
) -> None:
    noticed, healed = (one.at_s for one in walked.trial.noticed)
    whole, failed = (style.packed(colors["tibia"]) for colors in (LINK_COLORS, FAILED_COLORS))
    limp, told = "broken: leg 2 limp", "noticed: leg 2 limp"
    lanes = {
        paths.BROKEN: [(0, style.WHOLE), (BROKEN_S, limp), (HEALED_S, style.WHOLE)],
        paths.NOTICED: [(0, style.WATCHING), (noticed, told), (healed, style.WATCHING)],
    }
    for path, wanted in lanes.items():
        shown = timed(failing, path, "StateChange:state")
        assert shown == [(pytest.approx(time), [state]) for time, state in wanted]
    assert {limp, told} <= {*style.LANE_COLORS}, "each has a colour"
    colors = timed(failing, paths.link_path(2, "tibia"), "Capsules3D:colors")
    assert [(round(time, 6), *color) for time, color in colors] == [
        (0, whole), (BROKEN_S, failed), (HEALED_S, whole)
    ]  # fmt: skip
    assert len(timed(failing, paths.link_path(3, "tibia"), "Capsules3D:colors")) == 1
    labels = timed(failing, paths.foot_path(2), "Points3D:labels")
    assert labels == [(pytest.approx(BROKEN_S), ["leg 2 limp"]), (pytest.approx(HEALED_S), [])]
    marks = timed(failing, paths.noticed_path(2), "Points3D:labels")
    assert marks == [(pytest.approx(noticed), ["noticed: limp"]), (pytest.approx(healed), [])]


def test_a_walk_that_watches_no_legs_has_no_lane_of_what_it_noticed(trial: Trial, tmp_path: Path) -> None:
    failing = ReadBack(write(tmp_path / "a.rrd", trial))
    assert timed(failing, paths.BROKEN, "StateChange:state") == [(0, ["broken: leg 5 locked"])]
    assert not timed(failing, paths.NOTICED, "StateChange:state")
    assert not timed(failing, "leg_suspicion", "Scalars:scalars")


@pytest.fixture(scope="module")
def looks(tmp_path_factory: pytest.TempPathFactory) -> ReadBack:
    """A walk without leg 5 of a robot with a mesh for its trunk, and one that is turned for its tibias."""
    folder: Path = tmp_path_factory.mktemp("looks")
    (folder / "trunk.stl").write_bytes(stl_box())
    (folder / "shin.glb").write_bytes(glb_box())
    turned = {"file": "shin.glb", "scale": 0.02, "position_m": [0.0, 0.0, -0.06], "rotation_deg": [0, 0, 90]}
    file = edited_file(folder, put("meshes", {"body": {"file": "trunk.stl"}, "tibia": turned}))
    run(robot=str(file), failure=Failure(leg=5), duration_s=0.2, record=folder / "a.rrd")
    return ReadBack(folder / "a.rrd")


def test_a_mesh_takes_the_place_of_the_solid(looks: ReadBack) -> None:
    assert bytes(looks.values(f"/{paths.BODY}", "Asset3D:blob")[0][0]) == stl_box()
    assert not looks.values(f"/{paths.BODY}", "Cylinders3D:lengths")
    for leg in paths.LEGS:
        path = f"/{paths.link_path(leg, 'tibia')}"
        assert bytes(looks.values(path, "Asset3D:blob")[0][0]) == glb_box()
        assert looks.values(path, "Asset3D:media_type") == [["model/gltf-binary"]]
        color = FAILED_COLORS["tibia"] if leg == 5 else style.WHITE  # which leaves that of the file
        assert looks.values(path, "Asset3D:albedo_factor") == [[style.packed(color)]]
        assert not looks.values(path, "Capsules3D:lengths")
    assert looks.values(f"/{paths.link_path(2, 'femur')}", "Capsules3D:lengths"), "without a mesh"


def test_a_mesh_is_put_in_its_place(looks: ReadBack) -> None:
    path = f"/{paths.link_path(1, 'tibia')}"
    assert looks.values(path, "InstancePoses3D:translations")[0][0] == pytest.approx([0, 0, -0.06])
    assert looks.values(path, "InstancePoses3D:scales")[0][0] == pytest.approx([0.02] * 3)
    half = 0.5**0.5
    assert looks.values(path, "InstancePoses3D:quaternions")[0][0] == pytest.approx([0, 0, half, half])


def floor_mesh(heights_m: np.ndarray | None, path_end_m: np.ndarray) -> list[np.ndarray]:
    """Positions, triangles and normals of the floor's mesh."""
    mesh = make_floor_mesh(heights_m, path_end_m)
    parts = (mesh.vertex_positions, mesh.triangle_indices, mesh.vertex_normals)
    return [np.array(part.as_arrow_array().to_pylist(), dtype=float) for part in parts]


def test_an_even_floor_is_two_triangles_around_the_whole_path() -> None:
    positions, triangles, _ = floor_mesh(None, np.array([4.0, 0.0]))
    assert len(triangles) == 2
    assert positions[:, 0].min() < -1
    assert positions[:, 0].max() > 5


def test_bumps_have_the_heights_of_the_floor_and_face_up() -> None:
    floor = make_floor(World(roughness_m=0.01), seed=3)
    assert floor.heights_m is not None
    positions, triangles, normals = floor_mesh(floor.heights_m, np.array([1.0, 0.0]))
    axis = np.linspace(-8, 8, 400)
    column, row = (np.searchsorted(axis, positions[:, i] - 1e-5) for i in (0, 1))
    np.testing.assert_allclose(positions[:, 2], floor.heights_m[row, column], atol=1e-6)
    corners = positions[triangles.astype(int)]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (facing[:, 2] > 0).all()
    assert (normals[:, 2] > 0).all()
    positions, _, _ = floor_mesh(floor.heights_m, np.array([50.0, 50.0]))
    assert len(positions) <= 1.1 * MAX_VERTICES


def test_a_recording_opens_with_the_time_of_the_walk_and_a_live_view_follows_it(
    trial: Trial, tmp_path: Path
) -> None:
    import rerun as rr

    shown = {}
    for live in (False, True):
        path = tmp_path / f"{live}.rbl"
        layout = make_blueprint(trial.robot, trial.plan.heading_rad, trial.floor, watched=True, live=live)
        layout.save("hexctl", str(path))
        reader = rr.chunk.RrdReader(path)
        columns: dict[str, Any] = {}
        for chunk in reader.stream(store=reader.blueprints()[0]).to_chunks():
            batch = chunk.to_record_batch()
            columns |= {
                name: batch.column(name).to_pylist()[-1] for name in batch.schema.names if ":" in name
            }
        shown[live] = columns
    assert all(shown[live]["TimePanelBlueprint:timeline"] == [paths.WALK_TIMELINE] for live in shown)
    playing, following = (shown[live]["TimePanelBlueprint:play_state"] for live in (False, True))
    assert playing != following
