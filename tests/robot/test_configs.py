"""Shipped configuration files are found and every one of them loads."""

import pytest

from hexctl.backends.sim.world import load_world
from hexctl.robot.configs import config_names, find_config, read_mapping
from hexctl.robot.loader import load_robot


@pytest.mark.parametrize("name", config_names("robots"))
def test_every_shipped_robot_loads_under_its_own_name(name: str) -> None:
    assert load_robot(name).name == name


@pytest.mark.parametrize("name", config_names("worlds"))
def test_every_shipped_world_loads(name: str) -> None:
    family = "ranges" in read_mapping(find_config("worlds", name))
    assert load_world(f"{name}:3" if family else name).friction > 0


def test_the_promised_files_are_shipped() -> None:
    assert set(config_names("robots")) >= {"ant", "phantomx", "pexod"}
    assert set(config_names("worlds")) >= {"flat", "rough", "slippery", "slope"}
