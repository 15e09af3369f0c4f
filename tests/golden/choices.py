"""What the optimizers choose when told made-up results."""

import math
from typing import Any

import numpy as np

from hexctl import Failure, TrialPlan, load_robot, make_gait
from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation, Optimizer
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.sessions.session_optimizer import make_search
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.robot.configs import config_root

HEURISTICS = ("random", "exhaustive", "pso", "psosp", "dps", "debest", "derand")
SEARCHES = [(name, seed) for name in HEURISTICS for seed in (0, 7)]

#: Robot, failed leg, seed, and whether it is told how the robot stands.
BELIEVED = {
    "ant 5": ("ant", 5, 0, False),
    "ant 5, standing": ("ant", 5, 1, True),
    "ant 2, standing": ("ant", 2, 1, True),
    "pexod 2, standing": ("pexod", 2, 0, True),
    "pexod 3": ("pexod", 3, 0, False),
}

TICKS, DURATION_S = 1500, 30.0


def end_m(code: int, seed: int) -> float:
    """Made-up signed deviation of a gait."""
    return 0.8 * math.sin(1.7 * code + seed)


def walk(code: int, seed: int) -> tuple[float, Observation]:
    """Score and course of a made-up walk; every seventh gait falls after ten seconds."""
    share = np.arange(1, TICKS + 1) / TICKS
    path = np.column_stack([4.2 * share, end_m(code, seed) * share**1.5])
    if code % 7 == 0:
        fallen = Observation(path_m=path[:500], duration_s=10.0, yaw_change_rad=None, status="fell")
        return INVALID_SCORE, fallen
    turned = 0.1 * math.cos(code)
    whole = Observation(path_m=path, duration_s=DURATION_S, yaw_change_rad=turned, status="ok")
    return abs(end_m(code, seed)), whole


def believed(robot_name: str, leg: int, seed: int, stance: bool, trials: int = 10) -> dict[str, Any]:
    """The first choices of `bayes` with the shipped prior, and what it expects of each."""
    robot = load_robot(robot_name)
    failure = Failure(leg=leg)
    plan = TrialPlan(
        gait=make_gait(robot, "1", failed_legs=(leg,)), failures=(failure,), duration_s=DURATION_S
    )
    prior = config_root() / "priors" / f"{robot_name}-locked-rear-30s.npz"
    spec = SessionSpec(
        robot=robot_name,
        failed_leg=leg,
        optimizer="bayes",
        prior=str(prior),
        seed=seed,
        target_m=1e-6,
        sag_rad=[0.004 * math.sin(joint + leg) for joint in range(18)] if stance else None,
    )
    search = make_search(spec, robot, plan, load_prior(prior))
    codes, expected_m = [], []
    for _ in range(trials):
        (code,) = search.ask(1)
        expected = search.predict(code)
        assert expected is not None
        codes.append(code)
        expected_m.append([expected.signed_m, expected.sd_m])
        score, seen = walk(code, seed)
        search.tell([code], [score], [seen])
    return {"codes": codes, "expected_m": expected_m, "recommended": search.recommended()}


def bare(name: str, seed: int, trials: int = 40) -> list[int]:
    """The first choices of a heuristic as it stands in the paper, repeats among them."""
    return _told(make_optimizer(name, GaitSpace((5,)), seed), seed, trials)


def asked(name: str, seed: int, trials: int = 40) -> list[int]:
    """The first choices of a heuristic as a session asks it: no gait twice."""
    robot = load_robot("ant")
    plan = TrialPlan(gait=make_gait(robot, "1", failed_legs=(5,)), failures=(Failure(leg=5),))
    return _told(
        make_search(SessionSpec(failed_leg=5, optimizer=name, seed=seed), robot, plan, None), seed, trials
    )


def _told(search: Optimizer, seed: int, trials: int) -> list[int]:
    codes: list[int] = []
    for _ in range(trials):
        (code,) = search.ask(1)
        codes.append(code)
        search.tell([code], [abs(end_m(code, seed))])
    return codes
