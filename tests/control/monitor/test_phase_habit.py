"""What is usual at each part of the cycle is learned, for each robot of a batch by itself."""

import numpy as np

from hexctl.control.monitor.phase_habit import PARTS, RATE_PER_CYCLE, PhaseHabit, cycle_parts


def test_it_learns_a_quantity_of_the_cycle() -> None:
    habit, rng = PhaseHabit((2, 3)), np.random.default_rng(0)
    ticks = 60
    for tick in range(40 * ticks):
        parts = cycle_parts(np.full((2, 3), tick / ticks % 1))
        wave = np.sin(2 * np.pi * (parts + 0.5) / PARTS) * np.arange(1, 4)
        value = wave + 0.1 * rng.standard_normal((2, 3))
        habit.learn(RATE_PER_CYCLE / ticks * (value - habit.at(parts)))
    for part in range(PARTS):
        expected = np.sin(2 * np.pi * (part + 0.5) / PARTS) * np.arange(1, 4)
        np.testing.assert_allclose(habit.at(np.full((2, 3), part)), np.tile(expected, (2, 1)), atol=0.15)


def test_each_robot_has_its_own() -> None:
    habit = PhaseHabit((2, 1))
    habit.at(np.array([[3], [4]]))
    habit.learn(np.array([[1.0], [2.0]]))
    assert habit.at(np.array([[3], [3]])).tolist() == [[1.0], [0.0]]
    assert habit.at(np.array([[4], [4]])).tolist() == [[0.0], [2.0]]


def test_a_normalised_time_that_rounds_to_one_is_in_the_last_part() -> None:
    assert cycle_parts(np.array([0.0, 0.0833, 0.0834, 0.51, 0.999, 1.0])).tolist() == [0, 0, 1, 6, 11, 11]
