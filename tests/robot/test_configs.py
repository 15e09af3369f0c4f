"""Shipped configuration files are found and every one of them loads."""

import pytest

from hexctl.backends.sim.world import load_world
from hexctl.robot.configs import config_names
from hexctl.robot.file import load_robot


@pytest.mark.parametrize("name", config_names("robots"))
def test_every_shipped_robot_loads_under_its_own_name(name: str) -> None:
    assert load_robot(name).name == name


@pytest.mark.parametrize("name", config_names("worlds"))
def test_every_shipped_world_loads(name: str) -> None:
    assert load_world(name).friction > 0


def test_the_promised_files_are_shipped() -> None:
    assert set(config_names("robots")) >= {"ant", "phantomx", "pexod"}
    assert set(config_names("worlds")) >= {"flat", "rough", "slippery", "slope"}
