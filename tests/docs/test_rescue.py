"""The first picture of the README: a robot that recovers races the same robot without recovery."""

import pytest
from PIL import Image, ImageSequence

from hexctl.demo.rescue import RECOVER, WALK_ON, speed_kept, walk_and_fail
from pictures.rescue import RACE
from tests.docs.pages import ROOT

pytestmark = pytest.mark.slow

PICTURE = ROOT / "docs" / "images" / "rescue.gif"


@pytest.mark.parametrize(("policy", "kept"), [(WALK_ON, 0.47), (RECOVER, 1.02)])
def test_the_race_is_what_the_walks_do(policy: str, kept: float) -> None:
    assert speed_kept(walk_and_fail(policy, None)) == pytest.approx(kept, abs=0.03)


def test_the_picture_is_small_and_on_top_of_the_readme() -> None:
    assert PICTURE.stat().st_size <= 2_000_000
    with Image.open(PICTURE) as gif:
        assert gif.size[0] == RACE["width_px"]
        shown_ms = sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif))
    assert 5 <= shown_ms / 1000 <= 8.1
    head = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()[:6]
    assert any("docs/images/rescue.gif" in line for line in head)
