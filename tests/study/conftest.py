"""Landscapes of the made-up benchmark, and the searches in them."""

from typing import TYPE_CHECKING

import pytest

from hexctl.study.landscape import Landscape
from hexctl.study.transfer.transfer_searches import search_worlds
from tests.study.made_up_transfer import MODEL, in_the_model, plan

if TYPE_CHECKING:
    from pandas import DataFrame


@pytest.fixture(scope="session")
def landscapes() -> list[Landscape]:
    specs = plan().specs()
    worlds = MODEL.worlds(len(specs), seed=600)
    return [in_the_model(spec, world) for spec, world in zip(specs, worlds, strict=True)]


@pytest.fixture(scope="session")
def findings(landscapes: list[Landscape]) -> "DataFrame":
    return search_worlds(plan(), landscapes)
