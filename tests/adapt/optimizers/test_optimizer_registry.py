"""The registry of optimizers."""

import subprocess
import sys

import pytest

from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.errors import InputError
from hexctl.testing.optimizer_conformance import ONE_FAILED


def test_the_five_of_the_paper_and_two_baselines() -> None:
    assert list(OPTIMIZERS) == ["pso", "psosp", "dps", "debest", "derand", "random", "exhaustive"]


def test_the_names_alone_load_nothing_heavy() -> None:
    names = "import sys; from hexctl.adapt.optimizers.shipped import OPTIMIZERS; list(OPTIMIZERS)"
    code = f"{names}; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_an_optimizer_has_the_name_it_is_listed_under(name: str) -> None:
    assert make_optimizer(name, ONE_FAILED, 0).name == name


def test_an_unknown_name_lists_the_known_ones() -> None:
    known = r"bayes \(with a prior\), pso, psosp, dps, debest, derand, random, exh"
    with pytest.raises(InputError, match=f"got 'genetic'; allowed: {known}"):
        make_optimizer("genetic", ONE_FAILED, 0)


def test_a_custom_optimizer_by_the_name_of_its_module() -> None:
    optimizer = make_optimizer("hexctl.adapt.optimizers.baselines:RandomSearch", ONE_FAILED, 0)
    assert isinstance(optimizer, RandomSearch)


@pytest.mark.parametrize("name", ["nowhere:Thing", "math:nothing", ":", "math:"])
def test_one_that_cannot_be_loaded(name: str) -> None:
    with pytest.raises(InputError, match=f"'{name}' cannot be loaded"):
        make_optimizer(name, ONE_FAILED, 0)


@pytest.mark.parametrize("name", ["math:pi", "pathlib:Path"])
def test_one_that_is_no_optimizer(name: str) -> None:
    with pytest.raises(InputError, match="allowed: a subclass of Optimizer"):
        make_optimizer(name, ONE_FAILED, 0)
