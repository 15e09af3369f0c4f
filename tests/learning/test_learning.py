"""The Gymnasium environment, which is the walk of a trial; policies and their files."""

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.export.render import NoRendererError
from hexctl.gait.gait import make_gait
from hexctl.learning.environment import HexapodEnvironment, Observation
from hexctl.learning.learned_walk import ACTION_SIZE, OBSERVATION_SIZE, LearnedWalk
from hexctl.learning.policy import NetworkPolicy, load_policy
from tests.robots import shipped

ANT = shipped()

SHORT: dict[str, Any] = {"duration_s": 0.5, "failure_s": (0.1, 0.3)}


def made_up_policy() -> NetworkPolicy:
    """A network with drawn weights."""
    random = np.random.default_rng(3)
    sizes = ((OBSERVATION_SIZE, 16), (16, 16), (16, ACTION_SIZE))
    layers = tuple((0.3 * random.normal(size=size), random.normal(size=size[1])) for size in sizes)
    return NetworkPolicy(layers=layers, robot_fingerprint=ANT.fingerprint, origin={})


def plan_of(duration_s: float) -> TrialPlan:
    gait = make_gait(ANT, "tripod")
    return TrialPlan(gait=gait, duration_s=duration_s, self_rotation="none", hold="line")


def learned(start: WalkStart) -> LearnedWalk:
    return LearnedWalk(start, made_up_policy())


def course(environment: HexapodEnvironment, seed: int) -> tuple[list[Observation], list[float]]:
    """Observations and rewards of an episode under drawn actions."""
    observation, _ = environment.reset(seed=seed)
    random, seen, rewards, over = np.random.default_rng(0), [observation], [], False
    while not over:
        observation, reward, fell, ended, _ = environment.step(random.uniform(-1, 1, ACTION_SIZE))
        seen.append(observation)
        rewards.append(reward)
        over = fell or ended
    return seen, rewards


@pytest.mark.slow
def test_it_keeps_the_contract_of_gymnasium() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for environment in (
            gymnasium.make("hexctl/Hexapod-v0", worlds=("slippery",), **SHORT).unwrapped,
            HexapodEnvironment(**SHORT),
        ):
            check_env(environment, skip_render_check=True)
            environment.close()


@pytest.mark.slow
def test_pictures_are_of_the_episode_and_show_the_failed_leg(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    options: dict[str, Any] = {**SHORT, "failing": 1.0, "failures": ("missing",), "failure_s": (0.1, 0.1)}
    with gymnasium.make("hexctl/Hexapod-v0", render_mode="rgb_array", **options) as environment:
        environment.reset(seed=2)
        try:
            first, again = (np.asarray(environment.render(), dtype=int) for _ in range(2))
        except NoRendererError as error:
            pytest.skip(str(error))
        assert first.shape == (480, 640, 3)
        assert np.abs(again - first).max() <= 1, "nothing has moved"
        for _ in range(6):
            environment.step(np.zeros(ACTION_SIZE))
        changed = np.abs(np.asarray(environment.render(), dtype=int) - first).max(axis=-1) > 20
        assert 500 < int(changed.sum()) < 20_000, "a leg is almost transparent now"
    assert HexapodEnvironment(**SHORT).render() is None
    with pytest.raises(InputError):
        HexapodEnvironment(render_mode="human", **SHORT)


@pytest.mark.slow
def test_episodes_of_one_seed_are_alike_and_of_another_are_not() -> None:
    environment = HexapodEnvironment(worlds=("slope", "real:7000"), **SHORT)
    first, again, other = (course(environment, seed) for seed in (4, 4, 5))
    assert len(first[0]) == 26
    assert first[1] == again[1]
    np.testing.assert_array_equal(first[0], again[0])
    assert first[1] != other[1]


def test_an_episode_is_the_walk_of_a_trial_to_the_last_bit() -> None:
    environment = HexapodEnvironment(failing=0, duration_s=2.0)
    policy = made_up_policy()
    observation, info = environment.reset(seed=1)
    ended = False
    while not ended:
        before = info
        observation, _, _, ended, info = environment.step(policy(observation))
    result = run_sim_trial(SimTrial(robot=ANT, plan=plan_of(2.0), failures=None), learned)
    assert result.true_path_m is not None
    assert result.true_path_m[-1].tolist() == list(before.values()), (
        "the trial ends before its last targets act"
    )


def test_a_fall_ends_an_episode() -> None:
    environment = HexapodEnvironment(failing=0)
    environment.reset(seed=0)
    episode = environment._episode
    assert episode is not None
    episode.servos.compiled.physics.data.qpos[3:7] = (0.0, 1.0, 0.0, 0.0)  # on its back
    for _ in range(20):
        _, reward, fell, _, _ = environment.step(np.zeros(ACTION_SIZE))
        if fell:
            break
    assert fell
    assert reward < -5


def test_a_batch_of_learned_walks_equals_single_ones() -> None:
    plan = plan_of(0.5)
    trials = [SimTrial(robot=ANT, plan=plan, failures=None, world=world) for world in ("flat", "slope")]
    together = run_sim_trials(trials, 1, learned, apart=True)
    assert together == [run_sim_trial(trial, learned) for trial in trials]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"failures": ("limp:knee",)}, "failure"),
        ({"failures": ()}, "failures"),
        ({"failing": 1.5}, "failing"),
        ({"failure_s": (4.0, 1.0)}, "failure_s"),
        ({"failure_s": (1.0, 15.0)}, "failure_s"),
        ({"worlds": ()}, "^worlds: got none"),
        ({"duration_s": -1.0}, "^duration_s: got -1"),
        ({"duration_s": 0.0, "failing": 0}, "^duration_s: got 0"),
        ({"headings_deg": np.empty(0)}, "^headings_deg: got none"),
    ],
)
def test_an_episode_that_cannot_be_drawn_is_refused(options: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        HexapodEnvironment(**options)


def test_an_action_of_another_shape_is_refused() -> None:
    environment = HexapodEnvironment()
    environment.reset(seed=0)
    with pytest.raises(InputError, match=r"^action: got shape \(3,\); allowed: \(18,\)$"):
        environment.step(np.zeros(3))
    environment.close()


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_an_action_that_is_not_finite_is_refused_and_spoils_nothing(wrong: float) -> None:
    environments = [HexapodEnvironment(failing=0, duration_s=0.5) for _ in range(2)]
    for environment in environments:
        environment.reset(seed=0)
    action = np.full(ACTION_SIZE, 0.5)
    environments[0].step(action)
    with pytest.raises(InputError, match=r"^action: got"):
        environments[0].step(np.where(np.arange(ACTION_SIZE) == 7, wrong, action))
    environments[1].step(action)
    first, second = (environment.step(action) for environment in environments)
    np.testing.assert_array_equal(first[0], second[0])
    assert first[1] == second[1]
    assert np.isfinite(first[0]).all()


def test_one_world_one_failure_and_one_heading_need_no_list() -> None:
    one = HexapodEnvironment(worlds="slope", failures="limp", headings_deg=90.0, **SHORT)
    other = HexapodEnvironment(worlds=("slope",), failures=("limp",), headings_deg=(90.0,), **SHORT)
    np.testing.assert_array_equal(course(one, 3)[0], course(other, 3)[0])


def test_the_action_of_a_policy_is_that_of_its_network_and_a_file_keeps_it(tmp_path: Path) -> None:
    first = np.array([[1.0, -0.5], [0.25, 2.0]]), np.array([0.5, -0.25])
    last = np.array([[1.0], [-1.5]]), np.array([0.125])
    policy = NetworkPolicy(layers=(first, last), robot_fingerprint="ant", origin={"steps": 3})
    (action,) = policy(np.array([0.5, -1.0]))
    assert action == pytest.approx(np.tanh(0.75) - 1.5 * np.tanh(-2.5) + 0.125)
    policy.save(tmp_path / "small.npz")
    found = load_policy(tmp_path / "small.npz")
    assert (found.robot_fingerprint, found.origin) == ("ant", {"steps": 3})
    for one, other in zip(found.layers, policy.layers, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


@pytest.mark.slow
def test_a_policy_equals_torch() -> None:
    torch = pytest.importorskip("torch", reason="only with the extra `train`")
    policy, random = made_up_policy(), np.random.default_rng(0)
    values = torch.tensor(random.normal(size=(5, OBSERVATION_SIZE)), dtype=torch.float32)
    expected = values.double()
    for place, (weights, biases) in enumerate(policy.layers):
        expected = expected @ torch.tensor(weights) + torch.tensor(biases)
        expected = torch.tanh(expected) if place < len(policy.layers) - 1 else expected
    np.testing.assert_allclose(policy(values.numpy()), expected.numpy(), atol=1e-12)
