"""Shipped configuration files are found and every one of them loads."""

from pathlib import Path

import pytest

from hexctl.backends.sim.world import load_world
from hexctl.errors import InputError
from hexctl.robot.configs import config_names, find_config, read_mapping, shipped_text
from hexctl.robot.loader import load_robot
from tests.robots import ROBOT_NAMES, VENDORS_ROBOTS


@pytest.mark.parametrize("name", config_names("robots"))
def test_every_shipped_robot_loads_under_its_own_name(name: str) -> None:
    assert load_robot(name).name == name


@pytest.mark.parametrize("name", config_names("worlds"))
def test_every_shipped_world_loads(name: str) -> None:
    family = "ranges" in read_mapping(find_config("worlds", name))
    assert load_world(f"{name}:3" if family else name).friction > 0


def test_the_promised_files_are_shipped() -> None:
    assert set(config_names("robots")) >= {*ROBOT_NAMES, *VENDORS_ROBOTS}
    assert set(config_names("worlds")) >= {"flat", "rough", "slippery", "slope"}


def test_a_shipped_name_is_stored_in_one_spelling() -> None:
    texts = {"Randomized:07": "randomised:7", "randomised:7": "randomised:7", "FLAT": "flat", "flat": "flat"}
    others = ("world.yaml", "./Flat", "family.yaml:7", "nowhere", "nowhere:3", "randomised:x")
    for text, stored in {**texts, **dict(zip(others, others, strict=True))}.items():
        assert shipped_text("worlds", text) == stored
    assert shipped_text("robots", "ANT") == "ant"


@pytest.mark.parametrize(
    ("keys", "said"),
    [("friction: -1", "allowed: above 0"), ("friction: -1\nslope_deg: x", "(and 1 more problem)"),
     ("friction: -1\nslope_deg: x\npayload_kg: x", "(and 2 more problems)")],
)  # fmt: skip
def test_a_file_with_several_problems_says_how_many_more(keys: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "world.yaml").write_text(keys + "\n")
    with pytest.raises(InputError) as refused:
        load_world(tmp_path / "world.yaml")
    assert str(refused.value).endswith(said)
