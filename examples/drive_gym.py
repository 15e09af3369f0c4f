"""A robot that is driven as a Gymnasium environment: reset, step, an observation, a reward.

The action is a velocity as a share of the maximum: forward, left and turn, each -1 to 1. An episode is a walk
to a goal. Run it with `python examples/drive_gym.py`. The class has the methods of `gymnasium.Env`,
but does not need the package.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hexctl import Drive, EStopError, RobotState

#: Control periods in one step of the environment: ten decisions a second.
TICKS = 5

#: How near the goal is reached.
REACHED_M = 0.05


class GoalEnv:
    """Walk to a goal; the observation is where it is from the body: forward, left in m."""

    def __init__(self, robot: str = "ant", goal_m: tuple[float, float] = (0.6, 0.4)) -> None:
        self.drive = Drive(robot)
        self.goal_world = np.array(goal_m)
        self.drive.__enter__()

    def reset(
        self, *, seed: int | None = None, options: dict[str, object] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, object]]:
        """Stand where the simulation began; the first observation. Nothing in it is random."""
        return self._seen(self.drive.reset()), {}

    def step(
        self, action: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, object]]:
        """Walk with an action: observation, reward, reached, cut off by a stop, what else is known."""
        forward, left, turn = np.clip(action, -1, 1).tolist()
        velocity = self.drive.share(forward, left, turn)
        self.drive.command(velocity.forward_m_s, velocity.left_m_s, velocity.turn_rad_s)
        try:
            for _ in range(TICKS):
                state = self.drive.step()
        except EStopError:  # it fell
            return np.zeros(2), -1.0, False, True, {"stopped": self.drive.stopped}
        seen = self._seen(state)
        away_m = float(np.hypot(*seen))
        return seen, -away_m, away_m < REACHED_M, False, {"failures": self.drive.failures}

    def close(self) -> None:
        """Disconnect the robot."""
        self.drive.__exit__(None, None, None)

    def _seen(self, state: RobotState) -> NDArray[np.float64]:
        assert state.base_position_world is not None
        assert state.base_quaternion_world is not None
        w, x, y, z = state.base_quaternion_world.tolist()
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        dx, dy = (self.goal_world - state.base_position_world[:2]).tolist()
        return np.array([math.cos(yaw) * dx + math.sin(yaw) * dy, math.cos(yaw) * dy - math.sin(yaw) * dx])


def walk_to_goal(steps: int = 200) -> tuple[int, float]:
    """Steps until the goal is reached, and how far away it is then, by a policy that goes straight there."""
    env = GoalEnv()
    try:
        seen, _ = env.reset()
        count = 0
        while count < steps:
            count += 1
            action = np.array([*(3 * seen), 0.0])
            seen, _, reached, stopped, _ = env.step(action)
            if reached or stopped:
                break
        return count, float(np.hypot(*seen))
    finally:
        env.close()


if __name__ == "__main__":
    steps, away_m = walk_to_goal()
    print(f"{steps} steps, {100 * away_m:.1f} cm from the goal")
