"""The surveys of robots that `hexctl check` warns of: their intervals, solid legs, and what stops a robot."""

from dataclasses import replace

import pytest

from benchmarks.causes import DEFECTS, cause_rows
from benchmarks.check import make_legs_solid
from benchmarks.rows import Count
from benchmarks.scale import QUICK
from hexctl.backends.sim.servos import SimServos
from hexctl.robot.model import Robot
from tests.control.assessment.loads import moved_together


@pytest.mark.parametrize(
    ("count", "interval"),
    [
        (Count(31, 35), (0.740, 0.955)),
        (Count(0, 20), (0.0, 0.161)),
        (Count(20, 20), (0.839, 1.0)),
        (Count(0, 0), (0.0, 1.0)),
    ],
)
def test_intervals_hold_without_a_failure_and_without_a_robot(
    count: Count, interval: tuple[float, float]
) -> None:
    assert count.interval == pytest.approx(interval, abs=0.001)


def legs_in_contact(robot: Robot, *, solid: bool) -> int:
    """Contacts between two legs of a robot in its stance, after one control period."""
    with SimServos(robot) as servos:
        if solid:
            make_legs_solid(servos)
        servos.clock.tick()
        servos.read()
        physics = servos.compiled.physics
        names = [
            [physics.model.id2name(geom, "geom") for geom in (contact.geom1, contact.geom2)]
            for contact in physics.data.contact
        ]
    return sum(all("/leg" in name for name in pair) for pair in names)


def test_solid_legs_touch_where_others_pass_through() -> None:
    crowded = moved_together(0.05)
    assert legs_in_contact(crowded, solid=False) == 0
    assert legs_in_contact(crowded, solid=True) > 0
    assert legs_in_contact(moved_together(1.0), solid=True) == 0


@pytest.mark.slow
def test_the_defect_of_a_robot_is_found() -> None:
    rows = {row.name: row for row in cause_rows(replace(QUICK, walk_s=15.0))}
    assert rows.keys() == {f"check.causes.{defect}" for defect in DEFECTS}
    for row in rows.values():
        assert row.value == 1.0, row.note
        assert "1 of 1 named" in row.note
