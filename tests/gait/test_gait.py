"""Gaits and motions refuse what cannot be walked, and know their code."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.gait.encoding import Slots
from hexctl.gait.foot_trajectory import lift_offset, phase_in_cycle
from hexctl.gait.gait import (
    NAMED_SLOTS,
    Gait,
    Motion,
    half_amplitude_turn_rate_rad_s,
    make_gait,
    names_best,
    parse_slots,
)
from tests.robots import shipped

GOOD = {"slots": (1, 4, 2, 6, 3, 5), "pace_hz": 0.9, "amplitude": 0.11, "height": 0.02}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"slots": (1, 2, 3)}, "gait.*six numbers, each 1..6"),
        ({"slots": (0, 1, 2, 3, 4, 5)}, "gait.*each 1..6"),
        ({"slots": (1, 2, 3, 4, 5, 7)}, "gait.*each 1..6"),
        ({"pace_hz": 0}, "pace_hz: got 0; allowed: above 0 up to 10 Hz"),
        ({"pace_hz": -0.5}, "pace_hz: got -0.5"),
        ({"pace_hz": math.nan}, "pace_hz: got nan"),
        ({"pace_hz": math.inf}, "pace_hz: got inf"),
        ({"pace_hz": 11}, "pace_hz: got 11"),
        ({"amplitude": 0}, "amplitude: got 0; allowed: above 0 up to 1 of the robot's size"),
        ({"amplitude": 1.1}, "amplitude: got 1.1"),
        ({"amplitude": math.nan}, "amplitude: got nan"),
        ({"height": -0.1}, "height: got -0.1"),
        ({"height": math.inf}, "height: got inf"),
    ],
)
def test_a_gait_refuses_what_cannot_be_walked(change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Gait(**{**GOOD, **change})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"heading_rad": math.nan}, "heading nan"),
        ({"turn_rate_rad_s": math.inf}, "turn inf"),
        ({"travel": -0.1}, "travel: got -0.1; allowed: 0..1"),
        ({"travel": 1.5}, "travel: got 1.5"),
        ({"travel": math.nan}, "travel: got nan"),
    ],
)
def test_a_motion_refuses_what_is_no_direction(change: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Motion(**change)


def test_a_gait_knows_its_code_where_it_has_one() -> None:
    def gait(slots: tuple[int, ...]) -> Gait:
        return Gait(slots=slots, pace_hz=0.9, amplitude=0.11, height=0.02)

    assert gait((1, 2, 3, 4, 5, 6)).code() == 1
    assert gait((5, 1, 2, 4, 3, 6)).code() == 483
    assert gait(NAMED_SLOTS["tripod"]).code() is None, "legs share slots"
    assert gait((1, 2, 3, 4, 6, 5)).code((1,)) == 2
    assert gait((2, 1, 3, 4, 5, 6)).code((1,)) is None, "the failed leg is not in its own slot"


def test_turning_with_half_the_amplitude_is_the_papers_demo() -> None:
    """The demo turns with strokes of A/2 at radius 0.204: 221 degrees in 12 s less the ramp and slip."""
    ant = shipped()
    rate = half_amplitude_turn_rate_rad_s(
        ant, Gait(slots=NAMED_SLOTS["demo"], pace_hz=0.9, amplitude=0.11, height=0.02)
    )
    assert rate == pytest.approx(1.5 * 0.9 * 0.055 / 0.204)


def _swing_order(slots: Slots) -> list[int]:
    """Legs in the order in which their feet are highest in a cycle of the trajectory."""
    cycles = np.arange(600) / 600
    lifts = lift_offset(phase_in_cycle(cycles[:, np.newaxis], np.array(slots)))
    tops = cycles[lifts.argmax(axis=0)]
    return [int(leg) + 1 for leg in np.argsort(tops, kind="stable")]


def _from(order: list[int], leg: int) -> list[int]:
    """A cyclic order, rotated to begin with a leg."""
    start = order.index(leg)
    return order[start:] + order[:start]


def test_the_wave_goes_up_the_left_side_and_then_up_the_right() -> None:
    assert _from(_swing_order(NAMED_SLOTS["wave"]), 3) == [3, 2, 1, 4, 5, 6]


def test_the_ripple_goes_up_both_sides_half_a_cycle_apart() -> None:
    order = _from(_swing_order(NAMED_SLOTS["ripple"]), 3)
    assert order == [3, 6, 2, 4, 1, 5]
    left, right = [leg for leg in order if leg in (1, 2, 3)], [leg for leg in order if leg in (4, 5, 6)]
    assert left == [3, 2, 1]
    assert _from(right, 4) == [4, 5, 6]


def test_the_tripod_lifts_two_groups_of_three_in_turn() -> None:
    cycles = np.arange(600) / 600
    up = lift_offset(phase_in_cycle(cycles[:, np.newaxis], np.array(NAMED_SLOTS["tripod"]))) > 0
    groups = {tuple(int(leg) + 1 for leg in np.flatnonzero(row)) for row in up}
    assert groups == {(), (1, 3, 5), (2, 4, 6)}


@pytest.mark.parametrize("name", ["demo", "wave", "ripple"])
def test_swings_of_an_encoded_gait_follow_in_descending_slot_order(name: str) -> None:
    slots = NAMED_SLOTS[name]
    descending = sorted(range(1, 7), key=lambda leg: -slots[leg - 1])
    assert _from(_swing_order(slots), descending[0]) == descending


def test_the_default_is_the_demo_of_the_paper() -> None:
    assert NAMED_SLOTS["demo"] == (1, 4, 2, 6, 3, 5)


@pytest.mark.parametrize(
    ("text", "failed", "slots"),
    [
        ("tripod", (), (1, 4, 1, 4, 1, 4)),
        (" demo ", (), (1, 4, 2, 6, 3, 5)),
        ("1", (), (1, 2, 3, 4, 5, 6)),
        ("720", (), (6, 5, 4, 3, 2, 1)),
        ("120", (5,), (6, 4, 3, 2, 5, 1)),
        ("5,1,2,4,3,6", (), (5, 1, 2, 4, 3, 6)),
        ("5, 1, 2, 4, 3, 6", (), (5, 1, 2, 4, 3, 6)),
    ],
)
def test_a_gait_is_read_from_a_name_a_code_or_slots(text: str, failed: tuple[int, ...], slots: Slots) -> None:
    assert parse_slots(text, failed) == slots


@pytest.mark.parametrize(
    ("text", "failed", "words"),
    [
        ("gallop", (), r"gait: got 'gallop'; allowed: demo, tripod, wave, ripple, a code 1\.\.720, or slots"),
        ("gallop", (5,), r"a code 1\.\.120"),
        ("", (), r"gait: got ''"),
        ("1.5", (), r"gait: got '1.5'"),
        ("0", (), r"gait: got 0; allowed: 1\.\.720"),
        ("721", (), r"gait: got 721; allowed: 1\.\.720"),
        ("121", (5,), r"gait: got 121; allowed: 1\.\.120 with failed leg 5"),
        ("-3", (), r"gait: got -3"),
        ("1,2,3,4,5", (), r"gait: got 1,2,3,4,5; allowed: a permutation"),
        ("1,2,3,4,5,5", (), r"gait: got 1,2,3,4,5,5; allowed: a permutation"),
        ("1,2,3,4,5,x", (), r"gait: got '1,2,3,4,5,x'; allowed: six whole numbers"),
        ("1,2,3,4,5,", (), r"six whole numbers"),
        ("tripod\n1", (), r"gait: got 'tripod\\n1'"),
    ],
)
def test_anything_else_is_refused_with_what_is_allowed(
    text: str, failed: tuple[int, ...], words: str
) -> None:
    with pytest.raises(InputError, match=words) as refused:
        parse_slots(text, failed)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("gait", [57, np.int64(57), "57", (1, 4, 3, 5, 2, 6), [1, 4, 3, 5, 2, 6]])
def test_a_gait_is_made_from_text_or_numbers(gait: Any) -> None:
    made = make_gait(shipped(), gait)
    assert made.slots == (1, 4, 3, 5, 2, 6)
    assert made == make_gait(shipped(), "57")
    assert hash(made) == hash(make_gait(shipped(), "57"))


def test_slots_are_taken_from_any_sequence_of_whole_numbers() -> None:
    slots = Gait(**{**GOOD, "slots": np.array([1, 4, 2, 6, 3, 5])}).slots  # type: ignore[arg-type]
    assert slots == (1, 4, 2, 6, 3, 5)
    assert {type(slot) for slot in slots} == {int}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: make_gait("ant", "tripod"), "robot: got 'ant' .*allowed: a Robot, as load_robot"),  # type: ignore[arg-type]
        (lambda: make_gait(shipped(), None), r"gait: got None .*allowed: demo, tripod"),  # type: ignore[arg-type]
        (lambda: make_gait(shipped(), 57.0), r"gait: got 57.0 \(float\); allowed: demo, tripod"),  # type: ignore[arg-type]
        (lambda: make_gait(shipped(), "57", failed_legs=5), r"failed legs: got 5 \(int\)"),  # type: ignore[arg-type]
        (lambda: make_gait(shipped(), "57", pace_hz="0.9"), r"pace_hz: got '0.9' \(str\)"),  # type: ignore[arg-type]
        (lambda: Gait(**{**GOOD, "slots": "tripod"}), "gait: got 'tripod' .*allowed: 6 whole numbers"),  # type: ignore[arg-type]
        (lambda: Gait(**{**GOOD, "slots": 57}), "gait: got 57 .*allowed: 6 whole numbers"),  # type: ignore[arg-type]
        (lambda: Gait(**{**GOOD, "height": None}), "height: got None .*allowed: a number, above 0 up to 1"),  # type: ignore[arg-type]
        (lambda: Motion(heading_rad="0"), "motion.heading_rad: got '0' .*allowed: a number"),  # type: ignore[arg-type]
        (lambda: Motion(travel=True), "motion.travel: got True .*allowed: a number"),
    ],
)
def test_a_value_of_a_wrong_type_is_refused_at_once(make: Callable[[], object], message: str) -> None:
    with pytest.raises(WrongTypeError, match=message):
        make()


def test_a_gait_of_another_name_is_not_the_best() -> None:
    assert [names_best(gait) for gait in ("best", "best:x", "auto", "bestest", (1, 2, 3, 4, 5, 6))] == [
        True, True, False, False, False,
    ]  # fmt: skip


def test_phases_follow_the_slots_unless_they_are_given() -> None:
    gait = make_gait(shipped(), "demo")
    assert gait.leg_phases == tuple((slot - 1) / 6 for slot in gait.slots)
    quarters = (0.0, 0.0, 0.25, 0.5, 0.75, 0.0)
    crawl = replace(gait, phases=quarters)
    assert crawl.leg_phases == quarters
    assert gait.code() is not None
    assert crawl.code() is None


@pytest.mark.parametrize(
    "phases", [(0.0,) * 5, (0.0, 0.1, 0.2, 0.3, 0.4, 1.0), (0.0, 0.1, 0.2, 0.3, -0.1, 0.5)]
)
def test_phases_are_six_parts_of_a_cycle(phases: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"phases: got .*; allowed: 6 parts of a cycle, each 0 up to 1"):
        replace(make_gait(shipped(), "demo"), phases=phases)
