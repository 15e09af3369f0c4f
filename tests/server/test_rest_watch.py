"""At rest: joints that have stayed where they are for a while."""

import numpy as np

from hexctl.server.rest_watch import RestWatch


def test_joints_that_move_are_not_at_rest_and_those_that_tremble_are() -> None:
    watch, at_s = RestWatch(), 0.0
    angles_rad = np.zeros(18)

    def look(times: int, step_rad: float, noise_rad: float = 0.0) -> bool:
        nonlocal at_s
        for tick in range(times):
            at_s += 0.02
            angles_rad[4] += step_rad
            watch.note(angles_rad + noise_rad * (tick % 2), at_s)
        return watch.at_rest

    assert not look(5, 0.0), "too little was seen"
    assert look(10, 0.0)
    assert not look(10, 0.005)
    assert not look(5, 0.0), "it has moved of late"
    assert look(10, 0.0, noise_rad=0.005)


def test_servos_that_use_one_array_again_and_again_are_not_at_rest_while_they_move() -> None:
    watch, angles_rad = RestWatch(), np.zeros(18)
    for tick in range(20):
        angles_rad += 0.01
        watch.note(angles_rad, 0.02 * tick)
    assert not watch.at_rest


def test_unknown_angles_are_not_at_rest() -> None:
    watch = RestWatch()
    for tick in range(20):
        watch.note(np.full(18, np.nan), 0.02 * tick)
    assert not watch.at_rest


def test_servos_that_cannot_be_reached_are_not_at_rest() -> None:
    """What is told of them is of before, and does not change however they move."""
    watch = RestWatch()
    for index in range(20):
        watch.note(np.zeros(18), 0.02 * index, reached=index < 15)
        assert watch.at_rest == (10 <= index < 15)
