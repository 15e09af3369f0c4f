"""What fuzzing has found is refused, and so are a few other spoiled inputs of each decoder."""

import random

import pytest

from tests.fuzz.corpus import kept
from tests.fuzz.rooms import all_targets
from tests.fuzz.target import Target, spoiled

TARGETS = all_targets()


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS, ids=[target.name for target in TARGETS])
def test_nothing_falls(target: Target) -> None:
    chance = random.Random(target.name)
    known = [*target.seeds, *kept(target.name)]
    made = [
        spoiled(chance.choice(known), chance, target.words)[: target.most_bytes] for _ in range(target.times)
    ]
    falls = [fall for data in (*known, *made) if (fall := target.fall(data)) is not None]
    assert not falls, f"{falls[0].data!r}\n{falls[0].text}"


def test_a_fall_is_seen_and_an_allowed_refusal_is_none() -> None:
    def read(data: bytes) -> None:
        if data == b"wrong":
            raise ValueError("what a decoder may raise")
        [][len(data)]

    target = Target(name="broken", read=read, seeds=(), refusals=(ValueError,))
    assert target.fall(b"wrong") is None
    fall = target.fall(b"other")
    assert fall is not None
    assert fall.where.startswith("IndexError at test_targets.py:")
