"""Settings of the recovery benchmark."""

from typing import Any

import pytest

from hexctl.backends.sim.world import load_randomization
from hexctl.errors import InputError
from hexctl.study.held_out import FAILURES
from hexctl.study.hold_plan import FIRST_WORLD as FIRST_HOLD_WORLD
from hexctl.study.recovery.recovery_plan import (
    FIRST_WORLD,
    HEADINGS_DEG,
    HEXAHEAL,
    LINE,
    RecoveryPlan,
)
from tests.robots import shipped
from tests.study.recovery.made_up import plan


def test_every_robot_meets_every_failure_in_every_world_by_every_method() -> None:
    made = plan(robots=(shipped(), shipped("pexod")), gaits=("tripod", "wave"))
    made.check()
    walked = made.walked()
    line = [(one, cases) for one, cases in walked if one.protocol == LINE]
    assert [(one.robot.name, one.family, one.number) for one, _ in line] == [
        (robot, family, number)
        for robot in ("ant", "pexod")
        for family in ("transfer", "real")
        for number in (200, 201)
    ]
    for _, cases in line:
        assert len(set(cases)) == len(cases) == 2 * (len(HEADINGS_DEG) + 2 * 2 * 3)
        assert {case.heading_deg for case in cases if not case.legs} == set(HEADINGS_DEG)
    pairs = [(one, cases) for one, cases in walked if one.protocol == HEXAHEAL]
    assert [(one.robot.name, one.number, one.duration_s) for one, _ in pairs] == [
        (robot, run, 14.0) for robot in ("ant", "pexod") for run in (0, 1)
    ]
    for _, cases in pairs:
        assert {case.legs for case in cases} == {(2,), (5,), (2, 5)}
        assert {case.failure for case in cases} == {"limp"}


def test_by_default_all_joints_fail_and_hexaheal_has_its_21_sets_of_legs() -> None:
    made = RecoveryPlan(robots=(shipped(),), families=plan().families, worlds=1)
    assert len(FAILURES) == 3 + 2 * 3
    (_, line), *_, (_, pairs) = made.walked()
    assert len(line) == 4 + 6 * 9 * 3
    assert len(pairs) == 21 * 3
    assert made.first_world == FIRST_WORLD > FIRST_HOLD_WORLD


@pytest.mark.slow
def test_a_second_leg_fails_ten_seconds_after_the_first_in_either_order() -> None:
    made = RecoveryPlan(robots=(shipped(),), families=plan().families, protocols=("second",), runs=6)
    assert [one.duration_s for one, _ in made.walked()] == [36.0] * 6
    cases = [case for _, some in made.walked() for case in some if case.method == "told"]
    assert len(cases) == 15 * 6
    for case in cases:
        (first, second), trial = case.legs, made.walked()[0][0].trial(case)
        assert [event.leg for event in trial.events] == [first, second]
        assert [event.at_s for event in trial.events] == pytest.approx([case.at_s, case.at_s + 10.0])
    assert sum(first < second for first, second in (case.legs for case in cases)) == 15 * 3


def test_phase_and_heading_are_drawn_by_the_seed_and_are_the_same_for_all_methods() -> None:
    def drawn(seed: int) -> dict[tuple[Any, ...], set[tuple[float, float]]]:
        found: dict[tuple[Any, ...], set[tuple[float, float]]] = {}
        for one, cases in plan(seed=seed).walked():
            for case in cases:
                key = (one.protocol, one.family, one.number, case.legs, case.failure)
                if case.legs:
                    found.setdefault(key, set()).add((case.at_s, case.heading_deg))
        return found

    first = drawn(0)
    assert first == drawn(0) != drawn(1)
    assert {len(values) for values in first.values()} == {1}
    pace_hz = shipped().gait.pace_hz
    for (protocol, *_), values in first.items():
        ((at_s, heading_deg),) = values
        earliest_s = {LINE: 8.0, HEXAHEAL: 4.0}[protocol]
        assert earliest_s <= at_s <= earliest_s + 1 / pace_hz + 0.01
        assert heading_deg in (HEADINGS_DEG if protocol == LINE else (0.0,))


def test_sensors_are_late_and_noisy_unless_they_are_to_be_exact() -> None:
    assert {one.world.lost_poses for one, _ in plan().walked()} == {0.05}
    exact = plan(exact_sensors=True)
    assert exact.walked()[0][0].world == exact.families["transfer"].members(200, 1)[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robots": ()}, "robot: got none; allowed: one or more, each once"),
        ({"families": {}}, "world: got none"),
        (
            {"families": {"failing": load_randomization("failing")}},
            "world: got failing; allowed: a family without",
        ),
        ({"gaits": ("gallop",)}, "gaits: got gallop; allowed: one or more of demo"),
        ({"worlds": 0}, r"worlds: got 0; allowed: 1\.\.1000"),
        ({"runs": 0}, r"runs: got 0; allowed: 1\.\.999"),
        ({"seed": -1}, "seed: got -1; allowed: 0 or more"),
        ({"legs": (7,)}, "legs: got 7"),
        ({"failures": ("tired",)}, "failure: got 'tired'; allowed: locked, limp"),
        ({"failures": ("stuck:tibia:20",)}, "it jams where it is"),
        (
            {"methods": ("nothing", "hope")},
            "methods: got hope; allowed: nothing, told, recover, stop-diagnose",
        ),
        ({"methods": ("recover",)}, "methods: got recover; allowed: nothing among them"),
        ({"protocols": ("ours",)}, "protocols: got ours; allowed: one or more of line, hexaheal, second"),
        ({"duration_s": 9.0}, r"duration: got 9; allowed: 11\.1 to 86400 s"),
        ({"legs": [2]}, r"legs: got \[2\]"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan(**options).check()


def test_a_length_of_lines_does_not_matter_where_none_is_walked() -> None:
    plan(protocols=(HEXAHEAL,), duration_s=1.0).check()
