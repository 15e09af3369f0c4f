"""Train the policy of the recovery method `ppo`: `python -m benchmarks.train_ppo FOLDER [MINUTES] [SEED]`.

MINUTES are of one core. The folder gets the policy, checkpoints of it, and the learning curve as JSON lines.
The worlds are some of those that monitor and recovery of hexctl were tuned in. Needs the extra `train`.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from benchmarks.ppo_robots import RobotBatches, batches_of
from hexctl.backends.sim.world import load_world
from hexctl.learning.policy import NetworkPolicy
from hexctl.robot.loader import load_robot
from hexctl.study.held_out import FAILURES, with_sensors
from hexctl.study.recovery.recovery_plan import HEADINGS_DEG

ROBOT = "ant"

#: Worlds of training, with the sensors of the recovery benchmark.
WORLDS = {"transfer": range(500, 532), "real": range(7000, 7024)}

#: Ticks of each robot between two updates.
TICKS = 64

#: Of PPO: the discount makes rewards of the next second count, about one cycle.
GAMMA, EPOCHS, BATCH, RATE, MOST_CHANGE, FIRST_LOG_DEVIATION = 0.98, 10, 256, 3e-4, 0.03, -1.0

LAYERS = (64, 64)

#: Minutes between checkpoints.
CHECKPOINT = 2.0


def robots(seed: int) -> RobotBatches:
    """A robot in each world."""
    names = [f"{family}:{number}" for family, numbers in WORLDS.items() for number in numbers]
    worlds = [with_sensors(load_world(name)) for name in names]
    return RobotBatches(batches_of(load_robot(ROBOT), worlds), FAILURES, HEADINGS_DEG, seed)


def network_of(model: PPO, origin: dict[str, Any]) -> NetworkPolicy:
    """The mean action of a trained model as a policy."""
    actor = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    linear = [layer for layer in actor if isinstance(layer, torch.nn.Linear)]
    layers = [(layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in linear]
    return NetworkPolicy(
        layers=tuple((weights.astype(float), biases.astype(float)) for weights, biases in layers),
        robot_fingerprint=load_robot(ROBOT).fingerprint,
        origin=origin,
    )


def origin_of(model: PPO, seed: int) -> dict[str, Any]:
    """How a model was trained so far."""
    return {
        "algorithm": "PPO",
        "steps": int(model.num_timesteps),
        "core_minutes": round(time.process_time() / 60, 1),
        "seed": seed,
        "worlds": [f"{name}:{numbers[0]}-{numbers[-1]}" for name, numbers in WORLDS.items()],
        "failures": list(FAILURES),
    }


def point_of(model: PPO, learning: RobotBatches) -> dict[str, float]:
    """Point of the learning curve: means of the last episodes of each robot."""
    episodes = learning.finished[-learning.num_envs :]
    means = {name: float(np.mean([one[name] for one in episodes])) for name in (episodes or [{}])[0]}
    minutes = round(time.process_time() / 60, 2)
    return {"steps": int(model.num_timesteps), "core_minutes": minutes} | means


def train(folder: Path, minutes: float = 60.0, seed: int = 0) -> NetworkPolicy:
    """Train until the minutes of one core are over; save policy, checkpoints and curve."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    learning = robots(seed)
    model = PPO(
        "MlpPolicy",
        VecNormalize(learning, norm_obs=False, gamma=GAMMA),
        n_steps=TICKS,
        batch_size=BATCH,
        n_epochs=EPOCHS,
        learning_rate=RATE,
        gamma=GAMMA,
        target_kl=MOST_CHANGE,
        seed=seed,
        policy_kwargs={"net_arch": list(LAYERS), "log_std_init": FIRST_LOG_DEVIATION},
        device="cpu",
    )
    saved = 0.0
    while time.process_time() < 60 * minutes:
        model.learn(learning.num_envs * TICKS, reset_num_timesteps=False)
        with (folder / "curve.jsonl").open("a") as curve:
            curve.write(json.dumps(point_of(model, learning)) + "\n")
        if time.process_time() > 60 * (saved + CHECKPOINT):
            saved += CHECKPOINT
            network_of(model, origin_of(model, seed)).save(folder / f"{ROBOT}-{saved:g}.npz")
    policy = network_of(model, origin_of(model, seed))
    policy.save(folder / f"{ROBOT}.npz")
    return policy


if __name__ == "__main__":
    given = dict(zip(("minutes", "seed"), sys.argv[2:], strict=False))
    train(Path(sys.argv[1]), float(given.get("minutes", 60)), int(given.get("seed", 0)))
