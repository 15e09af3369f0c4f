"""`hexctl run --arena`: a walk ends softly before it leaves a circle."""

import json
from pathlib import Path
from typing import Any

import pytest

from hexctl.cli.main import exit_code
from tests.vision.test_place import saved

WALK = ["run", "--gait", "tripod", "--duration", "6", "--no-record", "--json"]


def walked(capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    assert exit_code([*WALK, *more]) == 0
    outcome: dict[str, Any] = json.loads(capsys.readouterr().out)
    return outcome


@pytest.mark.slow
def test_a_walk_ends_softly_inside_the_circle_around_its_start(capsys: pytest.CaptureFixture[str]) -> None:
    free = walked(capsys)
    assert (free["status"], free["stopped"]) == ("ok", None)
    radius_m = free["distance_m"] / 2
    kept = walked(capsys, "--arena", str(radius_m))
    assert (kept["status"], kept["stopped"]) == ("cut_short", "arena")
    assert 0 < kept["distance_m"] < radius_m
    assert walked(capsys, "--arena", str(2 * free["distance_m"]))["status"] == "ok"


def test_why_it_ended_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code([*WALK[:-1], "--arena", "0.3"]) == 0
    assert "cut short (arena): the walk was ended before it left the circle" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arena", "said"),
    [("0", "--arena: got 0; allowed: above 0"), ("wide", "--arena: got 'wide'")],
)
def test_bad_input_is_one_line(arena: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code([*WALK, "--arena", arena]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


def test_the_floor_of_a_simulation_is_none_that_a_camera_sees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code([*WALK, "--arena", str(saved(tmp_path))]) == 2
    assert "with --backend sim; allowed: a radius, or another --backend" in capsys.readouterr().err
