"""What is usual at each part of the cycle is learned, for each robot of a batch by itself."""

import numpy as np

from hexctl.control.monitor.phase_habit import PARTS, RATE_PER_CYCLE, PhaseHabit, cycle_parts

#: Three quantities of the second, first and fourth leg, of two robots.
LEGS = np.array([[1, 0, 3], [7, 6, 9]])


def test_it_learns_what_is_usual_in_each_part_of_the_cycle() -> None:
    habit, rng = PhaseHabit(LEGS), np.random.default_rng(0)
    habit.begin(np.zeros((2, 3)))
    ticks = 60
    for tick in range(40 * ticks):
        parts = cycle_parts(np.full((2, 6), tick / ticks % 1))
        wave = np.sin(2 * np.pi * (parts[:, :3] + 0.5) / PARTS) * np.arange(1, 4)
        habit.at(parts)
        habit.learn(wave + 0.1 * rng.standard_normal((2, 3)), np.full((2, 3), RATE_PER_CYCLE / ticks))
    for part in range(PARTS):
        expected = np.sin(2 * np.pi * (part + 0.5) / PARTS) * np.arange(1, 4)
        np.testing.assert_allclose(habit.at(np.full((2, 6), part)), np.tile(expected, (2, 1)), atol=0.15)


def test_each_quantity_goes_by_its_leg_and_each_robot_has_its_own() -> None:
    habit = PhaseHabit(LEGS)
    habit.begin(np.array([[0.0, 0.0, 0.0], [5.0, 5.0, 5.0]]))
    habit.at(np.array([[1, 2, 3, 4, 5, 6], [7, 8, 9, 10, 11, 0]]))
    habit.learn(np.full((2, 3), 9.0), np.full((2, 3), 0.5))
    for leg_1, leg_2, leg_4, expected in ((1, 2, 4, [4.5, 4.5, 4.5]), (1, 3, 4, [0.0, 4.5, 4.5])):
        parts = np.array([[leg_1, leg_2, 0, leg_4, 0, 0]] * 2)
        assert habit.at(parts)[0].tolist() == expected
    assert habit.at(np.array([[1, 2, 3, 4, 5, 6], [7, 8, 9, 10, 11, 0]]))[1].tolist() == [7.0, 7.0, 7.0]


def test_a_normalised_time_that_rounds_to_one_is_in_the_last_part() -> None:
    assert cycle_parts(np.array([0.0, 0.0833, 0.0834, 0.51, 0.999, 1.0])).tolist() == [0, 0, 1, 6, 11, 11]
