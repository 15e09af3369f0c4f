"""Gaits by name, code and slots, what cannot be walked, and poses of the body over its feet."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError, WrongTypeError
from hexctl.gait.body_pose import BodyPose, feet_from_body
from hexctl.gait.encoding import Slots, code_count, code_from_slots, slots_from_code
from hexctl.gait.foot_trajectory import lift_offset, part_of_cycle
from hexctl.gait.gait import (
    NAMED_SLOTS,
    Gait,
    Motion,
    gait_text,
    half_amplitude_turn_rate_rad_s,
    make_gait,
    parse_slots,
)
from hexctl.types import FloatArray
from tests.robots import shipped

GOOD = {"slots": (1, 4, 2, 6, 3, 5), "pace_hz": 0.9, "amplitude": 0.11, "height": 0.02}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("gait", slots) for slots in ((1, 2, 3), (0, 1, 2, 3, 4, 5), (1, 2, 3, 4, 5, 7))),
        *(("pace_hz", value) for value in (0, -0.5, math.nan, math.inf, 10.001)),
        *(("amplitude", value) for value in (0, 1.001, math.nan)),
        *(("height", value) for value in (0, -0.1, 1.001, math.inf)),
    ],
)
def test_a_gait_refuses_values_that_cannot_be_walked(name: str, value: Any) -> None:
    key = "slots" if name == "gait" else name
    with pytest.raises(InputError, match=f"{name}: got"):
        Gait(**{**GOOD, key: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("heading_rad", math.nan),
        ("turn_rate_rad_s", math.inf),
        *(("travel", value) for value in (-0.1, 1.001, math.nan)),
    ],
)
def test_a_motion_refuses_values_that_are_no_direction(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        Motion(**{name: value})


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


def _lifts(name: str) -> FloatArray:
    phases = (np.array(NAMED_SLOTS[name]) - 1) / 6
    return lift_offset(part_of_cycle(np.arange(600)[:, np.newaxis] / 600 + phases))


@pytest.mark.parametrize(
    ("name", "order"),
    [("demo", [3, 1, 4, 6, 2, 5]), ("wave", [3, 2, 1, 4, 5, 6]), ("ripple", [3, 6, 2, 4, 1, 5])],
)
def test_legs_swing_in_the_order_of_the_gait(name: str, order: list[int]) -> None:
    swung = [int(leg) + 1 for leg in np.argsort(_lifts(name).argmax(axis=0), kind="stable")]
    first = swung.index(3)
    assert swung[first:] + swung[:first] == order


@pytest.mark.parametrize(
    ("text", "failed", "slots"),
    [
        ("tripod", (), (1, 4, 1, 4, 1, 4)),
        (" demo ", (), (1, 4, 2, 6, 3, 5)),
        ("1", (), (1, 2, 3, 4, 5, 6)),
        ("720", (), (6, 5, 4, 3, 2, 1)),
        ("120", (5,), (6, 4, 3, 2, 5, 1)),
        ("5, 1, 2, 4, 3, 6", (), (5, 1, 2, 4, 3, 6)),
    ],
)
def test_a_gait_is_read_from_a_name_a_code_or_slots(text: str, failed: tuple[int, ...], slots: Slots) -> None:
    assert parse_slots(text, failed) == slots


@pytest.mark.parametrize(
    ("text", "failed", "named"),
    [
        ("gallop", (), r"'gallop'.*demo, tripod, wave, ripple, .*1\.\.720"),
        ("gallop", (5,), r"1\.\.120"),
        *((code, (), rf"gait: got {code}; .*1\.\.720") for code in ("0", "721", "-3")),
        ("0", (5,), r"got 0; .*1\.\.120"),
        ("121", (5,), r"got 121; .*1\.\.120"),
        ("7", (1, 3, 5), r"got 7; .*1\.\.6"),
        *((text, (), "gait: got") for text in ("", "1.5", "1,2,3,4,5", "1,2,3,4,5,5")),
        *(("1", failed, "failed legs") for failed in ((0,), (7,), (3, 9))),
        *((text, (), "six whole numbers") for text in ("1,2,3,4,5,x", "1,2,3,4,5,")),
        ("tripod\n1", (), r"'tripod\\n1'"),
    ],
)
def test_a_text_that_is_no_gait_is_refused_with_the_possible_ones(
    text: str, failed: tuple[int, ...], named: str
) -> None:
    with pytest.raises(InputError, match=named):
        parse_slots(text, failed)


@pytest.mark.parametrize("gait", [57, np.int64(57), "57", (1, 4, 3, 5, 2, 6), [1, 4, 3, 5, 2, 6]])
def test_a_gait_is_made_from_text_or_numbers(gait: Any) -> None:
    made = make_gait(shipped(), gait)
    assert made.slots == (1, 4, 3, 5, 2, 6)
    assert made == make_gait(shipped(), "57")
    assert hash(made) == hash(make_gait(shipped(), "57"))


WRONG_TYPES: dict[str, Callable[[], object]] = {
    "gait: got None": lambda: make_gait(shipped(), None),  # type: ignore[arg-type]
    "gait: got 57.0": lambda: make_gait(shipped(), 57.0),  # type: ignore[arg-type]
    "pace_hz: got '0.9'": lambda: make_gait(shipped(), "57", pace_hz="0.9"),  # type: ignore[arg-type]
    "gait: got 'tripod'": lambda: Gait(**{**GOOD, "slots": "tripod"}),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("named", WRONG_TYPES)
def test_a_value_of_a_wrong_type_is_refused(named: str) -> None:
    with pytest.raises(WrongTypeError, match=named):
        WRONG_TYPES[named]()


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
    with pytest.raises(InputError, match="phases: got"):
        replace(make_gait(shipped(), "demo"), phases=phases)


def test_the_text_of_a_gait_is_its_name_in_lower_case() -> None:
    assert gait_text(" Tripod ") == "tripod"
    assert gait_text(",".join(map(str, NAMED_SLOTS["tripod"]))) == "tripod"
    assert gait_text("mine.py:Gait") == "mine.py:Gait"


FAILED_SETS = [(), *((leg,) for leg in range(1, 7)), (2, 5), (1, 6), (1, 3, 5), (4, 5, 6)]


@pytest.mark.parametrize("failed", FAILED_SETS)
def test_codes_count_all_arrangements_in_lexicographic_order(failed: tuple[int, ...]) -> None:
    expected = [
        slots for slots in itertools.permutations(range(1, 7)) if all(slots[leg - 1] == leg for leg in failed)
    ]
    assert code_count(failed) == len(expected) == math.factorial(6 - len(failed))
    assert [slots_from_code(code, failed) for code in range(1, len(expected) + 1)] == expected
    assert [code_from_slots(slots, failed) for slots in expected] == [*range(1, len(expected) + 1)]


def test_slots_that_move_a_failed_leg_have_no_code() -> None:
    with pytest.raises(InputError, match="failed leg 5 has slot 4"):
        code_from_slots((1, 2, 3, 5, 4, 6), (5,))


def distances_m(feet: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(feet[:, None] - feet[None], axis=-1))


@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(np.array))
def test_a_pose_keeps_the_distances_between_the_feet(numbers: FloatArray) -> None:
    feet = shipped("ant").stance_feet_body
    posed = feet_from_body(feet, BodyPose.of(numbers).array)
    np.testing.assert_allclose(distances_m(posed), distances_m(feet), atol=1e-12)
    both = feet_from_body(feet, np.stack([np.zeros(6), numbers]))
    assert (both[0] == feet).all()
    assert (both[1] == posed).all()


@pytest.mark.parametrize(
    ("pose", "axis", "first", "second"),
    [
        # The front is lower: nearer to its feet.
        (BodyPose(pitch_rad=0.1), 2, (0.2, 0, -0.1), (-0.2, 0, -0.1)),
        (BodyPose(roll_rad=0.1), 2, (0, -0.2, -0.1), (0, 0.2, -0.1)),
        (BodyPose(yaw_rad=0.1), 1, (-0.2, 0, -0.1), (0.2, 0, -0.1)),
        (BodyPose(), 0, (0.2, 0, 0), (0.1, 0, 0)),
    ],
)
def test_signs_are_those_of_rep_103(
    pose: BodyPose, axis: int, first: tuple[float, ...], second: tuple[float, ...]
) -> None:
    posed = feet_from_body(np.array([first, second]), pose.array)
    assert posed[0, axis] > posed[1, axis]
