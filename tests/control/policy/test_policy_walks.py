"""Networks with the contract of each exporter walk, observe what a reference computes, and stop softly."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexctl
from hexctl.backends.sim.servos import SimServos
from hexctl.control.controllers import Controller
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.policy.policy import Policy
from hexctl.control.policy.policy_controller import PolicyController
from hexctl.control.preparation import WalkStart
from hexctl.control.trace import PHASES
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.types import JOINT_NAMES, FloatArray, RobotState
from tests.control.policy import networks
from tests.control.policy.reference import Tick, observation
from tests.robots import shipped

ANT = shipped()


@pytest.mark.parametrize("maker", networks.MAKERS.values(), ids=list(networks.MAKERS))
def test_a_network_of_each_exporter_walks(maker: Callable[[Path], Path], tmp_path: Path) -> None:
    done = hexctl.run(policy=maker(tmp_path), duration_s=6, record=False)
    assert done.trial.status == "ok"
    assert done.trial.distance_m is not None
    assert done.trial.distance_m > 0.25
    assert abs(done.trial.deviation.final) < 0.05 if done.trial.deviation else False
    assert (
        done.outcome["policy"]["inferences"]
        == len(done.log["policy_action"]) - np.isnan(done.log["policy_action"][:, 0]).sum()
    )
    assert done.outcome["gait"] is None


class Watched(Controller):
    """A policy's controller that keeps what it saw."""

    def __init__(self, start: WalkStart, policy: Policy, command: FloatArray) -> None:
        self.inner = PolicyController(start, policy, command)
        self.ticks: list[tuple[RobotState, FloatArray, FloatArray, FloatArray]] = []
        self._last = np.zeros(18)

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        targets_rad = self.inner.targets_rad(step, state)
        if values := self.inner.own_values:
            seen = values["policy_observation"]
            self.ticks.append((state, self.inner.velocity_body.copy(), self._last, seen))
            self._last = values["policy_action"]
        return targets_rad

    def stop(self, step: int) -> int:
        return self.inner.stop(step)


def seen_by(
    policy: Policy, duration_s: float = 2.2
) -> list[tuple[RobotState, FloatArray, FloatArray, FloatArray]]:
    made: list[Watched] = []

    def make(start: WalkStart) -> Watched:
        made.append(Watched(start, policy, np.array([0.1, 0.0, 0.05])))
        return made[0]

    with Guard(SimServos(ANT)) as servos:
        plan = TrialPlan(gait=make_gait(ANT, "tripod"), duration_s=duration_s, self_rotation="none")
        run_trial(servos, plan, make, soft_stop=False)
    return made[0].ticks


def reference_terms(name: str) -> tuple[list[dict[str, Any]], bool]:
    """Terms of the files of `networks`, read off by hand."""
    joints = list(networks.BY_KIND)
    stance = {joint: float(angle) for joint, angle in zip(JOINT_NAMES, ANT.stance_angles_rad, strict=True)}
    period = networks.gaiter().period_s

    def about(kind: str, names: list[str], scale: float = 1.0, **more: Any) -> dict[str, Any]:
        return {"is": kind, "names": names, "scale": scale, **more}

    def offsets(names: list[str], digits: int = 12) -> list[float]:
        return [
            round((-1 if name.startswith("-") else 1) * stance[name.removeprefix("-")], digits)
            for name in names
        ]

    phase: dict[str, Any] = {"is": "phase", "period": period}
    if name == "mjlab":
        return [
            {"is": "gravity"},
            about("position", joints, history=3, offsets=offsets(joints, 3)),
            about("velocity", joints, 0.05),
            {"is": "last"},
            {"is": "command"},
            phase,
        ], False
    if name == "isaac":
        return [
            {"is": "rate", "scale": 0.25},
            {"is": "gravity"},
            {"is": "command"},
            about("position", joints, offsets=offsets(joints)),
            about("velocity", joints, 0.05),
            {"is": "last", "history": 2},
            phase,
        ], False
    if name == "unitree":
        signed = [f"-{one}" if one in ("leg4_coxa", "leg5_coxa", "leg6_coxa") else one for one in joints]
        terms: list[dict[str, Any]] = [
            {"is": "rate", "scale": 0.2},
            {"is": "gravity"},
            {"is": "command"},
            about("position", signed, offsets=offsets(signed)),
            about("velocity", signed, 0.05),
            {"is": "last"},
            phase,
        ]
        return [term | {"history": 4} for term in terms], True
    signed = [f"-{one}" if one in ("leg1_femur", "leg4_tibia") else one for one in joints]
    return [
        {"is": "rate", "scale": 0.25},
        {"is": "gravity"},
        about("position", signed, offsets=offsets(signed)),
        about("velocity", signed, 0.05),
        {"is": "last"},
        {"is": "command", "scale": 2.0},
        phase,
    ], False


@pytest.mark.parametrize("name", networks.MAKERS)
def test_observations_equal_a_reference_implementation(name: str, tmp_path: Path) -> None:
    ticks = seen_by(Policy.load(networks.MAKERS[name](tmp_path)))
    assert len(ticks) > 50
    terms, by_time = reference_terms(name)
    for count in (1, 2, 3, 10, len(ticks)):
        history: list[Tick] = [(state, command.tolist(), last) for state, command, last, _ in ticks[:count]]
        expected = observation(terms, history, by_time=by_time)
        np.testing.assert_allclose(ticks[count - 1][3], expected, atol=1e-5)


def test_angles_without_velocities_give_differences_half_a_tick_late(tmp_path: Path) -> None:
    policy = Policy.load(networks.own(tmp_path))
    lukas = shipped("lukas")
    assert "joint_velocities" not in lukas.sensors
    terms = [term for term in policy.contract.terms if term.kind == "joint_vel"]
    from hexctl.control.policy.observation import Observer

    observer = Observer(policy.contract, 0.02)
    seen = []
    for step in range(3):
        state = RobotState(np.full(18, 0.001 * step**2), 0.02 * step, True)
        observer.sees(step, state)
        seen.append(
            observer.observation(
                step, state, command=np.zeros(3), last_action=np.zeros(18), sent_rad=np.zeros(18)
            )
        )
    place = [policy.contract.observation_names.index("joint_vel_0")]
    velocities = [float(each[place[0]] / terms[0].scale[0]) for each in seen]
    assert velocities == pytest.approx([0.0, 0.05, 0.15])


def test_the_policy_starts_and_ends_softly_in_the_stance(tmp_path: Path) -> None:
    done = hexctl.run(policy=networks.own(tmp_path), duration_s=4, record=False)
    check_soft_ends(done)
    requested, walk = done.log["requested_rad"], done.log["phase"] == PHASES.index("walk")
    np.testing.assert_allclose(requested[walk][0], ANT.stance_angles_rad, atol=1e-9)


def check_soft_ends(done: Any) -> None:
    """Before and after its own actions, the targets move slowly, and they end in the stance."""
    requested, own = done.log["requested_rad"], np.isfinite(done.log["policy_action"][:, 0])
    steps = np.abs(np.diff(requested, axis=0))
    moved = steps[done.log["phase"][1:] >= PHASES.index("walk")]
    ours = own[1:][done.log["phase"][1:] >= PHASES.index("walk")]
    assert (moved[~ours] <= 0.3 * ANT.joint_max_speed_rad_s * 0.02).all()
    np.testing.assert_allclose(requested[-1], ANT.stance_angles_rad, atol=1e-9)


def test_a_recording_has_raw_observations_and_actions(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    done = hexctl.run(policy=networks.own(tmp_path), duration_s=3, record=tmp_path / "walk.rrd")
    assert done.recording is not None
    trial = hexctl.read_trial(done.recording)
    rows = trial.policy["observation"].rows
    assert len(rows) == done.outcome["policy"]["inferences"]
    for name in ("observation", "action"):
        expected = done.log[f"policy_{name}"][rows]
        np.testing.assert_allclose(trial.policy[name].values, expected, atol=1e-5)
    table = hexctl.export(done.recording, to="csv", output=tmp_path / "walk.csv")
    head = table.read_text().splitlines()[0].split(",")
    assert "policy_observation_gait_phase_1" in head
    assert "policy_action_leg6_tibia" in head


# ---- what goes wrong in mid-walk


def act_with(policy: Policy, change: Callable[[FloatArray, int], FloatArray]) -> Policy:
    """A policy whose actions change after half a second."""
    calls = iter(range(10**9))
    return Policy(policy.contract, lambda seen: change(policy.act(seen), next(calls)), "made up")


def broken(kind: str, policy: Policy) -> Policy:
    def change(action: FloatArray, call: int) -> FloatArray:
        if call < 25:
            return action
        if kind == "nan":
            return np.where(np.arange(18) == 4, np.nan, action)
        if kind == "raises":
            raise RuntimeError("no more")
        if kind == "size":
            return action[:12]
        if kind == "infinite":
            return action + np.inf
        raise MemoryError

    return act_with(policy, change)


@pytest.mark.parametrize("kind", ["nan", "raises", "size", "infinite", "memory"])
def test_a_policy_that_fails_stops_softly_with_a_whole_recording(kind: str, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    policy = broken(kind, Policy.load(networks.own(tmp_path)))
    done = hexctl.run(policy=policy, duration_s=5, record=tmp_path / "walk.rrd")
    check_soft_stop(done)


def check_soft_stop(done: Any) -> None:
    assert done.trial.status == "aborted"
    assert done.trial.stopped is not None
    assert done.trial.stopped.startswith("policy: ")
    assert 1.0 < done.trial.duration_s < 2.5
    assert done.recording_error is None
    check_soft_ends(done)
    assert len(hexctl.read_trial(done.recording)) == len(done.log)


def test_two_slow_inferences_in_a_row_stop_a_paced_walk_and_one_does_not(tmp_path: Path) -> None:
    policy = Policy.load(networks.own(tmp_path))
    now_s = [0.0]

    def clock() -> float:
        return now_s[0]

    def trial(slow: set[int]) -> Any:
        def change(action: FloatArray, call: int) -> FloatArray:
            now_s[0] += 0.03 if call in slow else 0.001
            return action

        made = act_with(policy, change)
        with Guard(SimServos(ANT)) as servos:
            plan = TrialPlan(gait=make_gait(ANT, "tripod"), duration_s=3, self_rotation="none")
            return run_trial(
                servos,
                plan,
                lambda start: PolicyController(start, made, [0.1, 0, 0], limit_s=0.01, now_s=clock),
            )

    assert trial({20, 22, 24, 26}).status == "ok"
    stopped = trial({20, 21})
    assert stopped.status == "aborted"
    assert "10 ms" in stopped.stopped


@pytest.mark.realtime
def test_inferences_of_30_ms_stop_a_walk_in_real_time(tmp_path: Path) -> None:
    import time

    pytest.importorskip("rerun")
    policy = Policy.load(networks.own(tmp_path))

    def change(action: FloatArray, call: int) -> FloatArray:
        if call >= 25:
            time.sleep(0.03)
        return action

    done = hexctl.run(
        policy=act_with(policy, change), duration_s=5, record=tmp_path / "walk.rrd", realtime=True
    )
    check_soft_stop(done)


def test_a_file_that_is_deleted_during_the_walk_changes_nothing(tmp_path: Path) -> None:
    path = networks.own(tmp_path)
    policy = Policy.load(path)
    done = hexctl.run(policy=act_with(policy, _deleting(path)), duration_s=3, record=False)
    assert not path.exists()
    assert done.trial.status == "ok"


def _deleting(path: Path) -> Callable[[FloatArray, int], FloatArray]:
    def change(action: FloatArray, call: int) -> FloatArray:
        if call == 20:
            path.unlink()
            path.with_suffix(".yaml").unlink()
        return action

    return change


def test_a_measurement_that_goes_missing_stops_the_policy(tmp_path: Path) -> None:
    policy = Policy.load(networks.own(tmp_path))

    class Losing(PolicyController):
        def targets_rad(self, step: int, state: RobotState) -> FloatArray:
            if step > 90:
                from dataclasses import replace

                state = replace(state, base_quaternion_world=None)
            return super().targets_rad(step, state)

    with Guard(SimServos(ANT)) as servos:
        plan = TrialPlan(gait=make_gait(ANT, "tripod"), duration_s=4, self_rotation="none")
        result = run_trial(servos, plan, lambda start: Losing(start, policy, [0.1, 0, 0]))
    assert result.status == "aborted"
    assert result.stopped is not None
    assert "projected_gravity" in result.stopped


def test_a_term_that_the_robot_does_not_measure_is_refused_with_its_name(tmp_path: Path) -> None:
    path = networks.own(tmp_path, "lukas")
    with pytest.raises(InputError, match="base_ang_vel"):
        hexctl.run(robot="lukas", policy=path, duration_s=3, record=False)
    (tmp_path / "own.yaml").unlink()
    stand_in = {"base_ang_vel": [0, 0, 0], "projected_gravity": [0, 0, -1]}
    again = networks.own(tmp_path, "lukas", stand_in=stand_in)
    done = hexctl.run(robot="lukas", policy=again, duration_s=5, record=False)
    assert done.trial.status == "ok"
    assert done.trial.true_distance_m is not None
    assert done.trial.true_distance_m > 0.05


def test_options_of_gaits_are_refused_and_commands_beyond_the_ranges(tmp_path: Path) -> None:
    path = networks.own(tmp_path)
    for more, named in (
        ({"gait": "wave"}, "gait"),
        ({"hold": "heading"}, "hold"),
        ({"speed_m_s": 3.0}, "3 for the velocity forward"),
        ({"heading_rad": 2.0}, "heading"),
        ({"controller": lambda _, state: state.joint_positions_rad}, "controller"),
    ):
        with pytest.raises(InputError, match=named):
            hexctl.run(policy=path, duration_s=1, record=False, **more)
    with pytest.raises(InputError, match="policy"):
        hexctl.run(speed_m_s=0.1, duration_s=1, record=False)


def test_a_policy_turns_on_the_spot(tmp_path: Path) -> None:
    done = hexctl.run(policy=networks.own(tmp_path), turn_rate_rad_s=0.15, duration_s=8, record=False)
    assert done.trial.status == "ok"
    assert done.trial.yaw_change_rad is not None
    assert 0.3 < done.trial.yaw_change_rad < 1.2


def test_a_policy_is_driven_and_returns_to_the_stance(tmp_path: Path) -> None:
    with hexctl.Drive("ant", policy=networks.own(tmp_path)) as drive:
        start = drive.reset().base_position_world
        drive.command(forward_m_s=0.5)  # beyond its range
        for _ in range(300):
            state = drive.step()
        assert drive.velocity.forward_m_s == pytest.approx(networks.gaiter().full_m_s)
        assert start is not None
        assert state.base_position_world is not None
        assert state.base_position_world[0] - start[0] > 0.3
        drive.command()
        for _ in range(150):
            drive.step()
        assert drive.at_rest
        np.testing.assert_allclose(drive.guard.accepted_rad(), ANT.stance_angles_rad, atol=1e-6)
        drive.sit()
        for _ in range(300):
            drive.step()
        assert drive.mode == "sitting"


def test_a_driven_policy_that_fails_stops_the_drive_and_may_go_on_after_stand(tmp_path: Path) -> None:
    policy = broken("nan", Policy.load(networks.own(tmp_path)))
    with hexctl.Drive("ant", policy=policy) as drive:
        drive.reset()
        drive.command(forward_m_s=0.1)
        for _ in range(250):
            drive.step()
        assert drive.stopped is not None
        assert drive.stopped.startswith("policy: ")
        assert drive.at_rest
        drive.stand()
        assert drive.stopped is None


def test_python_that_loads_hexctl_does_not_load_onnxruntime() -> None:
    code = "import hexctl.runs.run, hexctl.cli.main, sys; print('onnxruntime' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "False"


def test_the_log_gives_nan_before_the_policy_walks(tmp_path: Path) -> None:
    log: TickLog = hexctl.run(policy=networks.own(tmp_path), duration_s=2, record=False).log
    actions = log["policy_action"]
    assert actions.shape == (len(log), 18)
    assert np.isnan(actions[0]).all()
    with pytest.raises(KeyError):
        log["policy_other"]
