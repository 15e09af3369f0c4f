"""Feasibility of a gait on a robot, as a Python program asks for it."""

import json
import math

import pytest

from hexctl.control.assessment.feasibility import check_robot
from hexctl.errors import InputError


def test_it_is_checked_all_round_unless_a_heading_is_given() -> None:
    all_round, forward = check_robot("phantomx"), check_robot("phantomx", heading_rad=0.0)
    assert all_round.possible
    assert (all_round.demand.lowest_rad <= forward.demand.lowest_rad + 1e-9).all()
    assert (all_round.demand.peak_speed_rad_s >= forward.demand.peak_speed_rad_s - 1e-9).all()


def test_a_turn_without_a_heading_is_made_in_place() -> None:
    for rate_rad_s in (0.0, math.radians(20)):
        in_place = check_robot("ant", turn_rate_rad_s=rate_rad_s).demand
        coxa_rad = in_place.highest_rad[::3] - in_place.lowest_rad[::3]
        assert (coxa_rad > 0.1).all() == (rate_rad_s > 0)
    assert in_place.max_pace_hz is None


def test_the_report_is_plain_and_says_what_the_object_says() -> None:
    checked = check_robot("pexod", "tripod", pace_hz=0.5, amplitude=0.05, height=0.03)
    report = json.loads(json.dumps(checked.to_dict(), allow_nan=False))
    assert report["robot"] == "pexod"
    assert report["gait"]["pace_hz"] == 0.5
    assert report["possible"] == checked.possible
    assert report["gait_fits_pulses"] == checked.gait_fits_servos
    assert len(report["joints"]) == len(report["pulses_us"]) == 18


def test_an_impossible_gait_is_a_result_and_a_bad_value_an_error() -> None:
    assert not check_robot("ant", amplitude=0.5).possible
    with pytest.raises(InputError, match=r"pace_hz: got 0; allowed: above 0"):
        check_robot("ant", pace_hz=0)
