"""What is usual at each part of the cycle is learned, for each robot of a batch by itself."""

import numpy as np

from hexctl.control.monitor.phase_habit import PARTS, RATE_PER_CYCLE, PhaseHabit


def test_it_learns_a_quantity_of_the_cycle_and_its_spread() -> None:
    habit, rng = PhaseHabit((2, 3)), np.random.default_rng(0)
    habit.begin(np.zeros((2, 3)))
    ticks = 60
    for tick in range(40 * ticks):
        cycle = np.full((2, 3), tick / ticks % 1)
        parts = (cycle * PARTS).astype(int)
        value = np.sin(2 * np.pi * (parts + 0.5) / PARTS) * np.arange(1, 4) + 0.1 * rng.standard_normal(
            (2, 3)
        )
        mean, spread = habit.at(parts)
        rate = RATE_PER_CYCLE / ticks
        habit.learn(rate * (value - mean), rate * (np.abs(value - mean) - spread))
    for part in range(PARTS):
        mean, spread = habit.at(np.full((2, 3), part))
        expected = np.sin(2 * np.pi * (part + 0.5) / PARTS) * np.arange(1, 4)
        np.testing.assert_allclose(mean, np.tile(expected, (2, 1)), atol=0.15)
        assert (spread < 0.25).all()


def test_each_robot_has_its_own() -> None:
    habit = PhaseHabit((2, 1))
    habit.begin(np.array([[0.0], [5.0]]))
    habit.at(np.array([[3], [4]]))
    habit.learn(np.array([[1.0], [1.0]]), np.zeros((2, 1)))
    assert habit.at(np.array([[3], [3]]))[0].tolist() == [[1.0], [5.0]]
    assert habit.at(np.array([[4], [4]]))[0].tolist() == [[0.0], [6.0]]
