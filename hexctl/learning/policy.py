"""Policies as small files: the layers of a network, and how it was trained."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.archive import ArchiveKind
from hexctl.robot.configs import config_root
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

VERSION = 1

KIND = ArchiveKind(name="policy", versions=(VERSION,), command="python -m benchmarks.train_ppo")

#: Folder of shipped policies, each named by its robot.
POLICIES = "policies"


@dataclass(frozen=True, kw_only=True, eq=False)
class NetworkPolicy:
    """A network of fully connected layers with tanh between them.

    Attributes:
        layers: weights (inputs, outputs) and biases (outputs,) of each layer.
        robot_fingerprint: of the robot that it was trained with.
        origin: how it was trained, in JSON values.
    """

    layers: tuple[tuple[FloatArray, FloatArray], ...]
    robot_fingerprint: str
    origin: dict[str, Any]

    def __call__(self, observation: FloatArray | NDArray[np.float32]) -> FloatArray:
        """Action of an observation, leading shapes + (18,) and + (OBSERVATION_SIZE,)."""
        values = observation.astype(np.float32).astype(float)  # as the environment gives it
        for place, (weights, biases) in enumerate(self.layers):
            # A batch equals single robots to the last bit, which it does not with the products of BLAS.
            values = np.add.reduce(values[..., np.newaxis] * weights, axis=-2) + biases
            if place < len(self.layers) - 1:
                values = np.tanh(values)
        return np.asarray(values)

    def save(self, path: Path) -> None:
        """Write a policy atomically, in single precision; raises ArchiveFileError when the disk refuses."""
        arrays: dict[str, NDArray[Any]] = {}
        for place, (weights, biases) in enumerate(self.layers):
            arrays[f"weights{place}"], arrays[f"biases{place}"] = (
                each.astype(np.float32) for each in (weights, biases)
            )
        head = {"robot_fingerprint": self.robot_fingerprint, "origin": self.origin}
        KIND.save(path, VERSION, head, arrays)


def load_policy(path: Path | str) -> NetworkPolicy:
    """Policy of a file; raises InputError for a wrong, damaged or altered file, or another version."""
    return KIND.load(path, _made)


def _made(head: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> NetworkPolicy:
    count = len(arrays) // 2
    pairs = [(arrays[f"weights{place}"], arrays[f"biases{place}"]) for place in range(count)]
    layers = tuple((weights.astype(float), biases.astype(float)) for weights, biases in pairs)
    return NetworkPolicy(layers=layers, robot_fingerprint=head["robot_fingerprint"], origin=head["origin"])


def policy_file(robot: Robot) -> Path:
    """File of the shipped policy of a robot, which may be missing."""
    return config_root() / POLICIES / f"{robot.name}.npz"


def policy_of(robot: Robot) -> NetworkPolicy:
    """The shipped policy of a robot; raises InputError for a robot without one."""
    return KIND.load_of_robot(policy_file(robot), robot.name, robot.fingerprint, _made)
