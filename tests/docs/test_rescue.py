"""The first picture of the README: recovery beside the same robot without it."""

import pytest
from PIL import Image

from hexctl.demo.rescue import RECOVER, WALK_ON, speed_kept, walk_and_fail
from pictures.rescue import SHOWN_S, WIDTH_PX
from tests.docs.pages import ROOT

PICTURE = ROOT / "docs" / "images" / "rescue.gif"


@pytest.mark.parametrize(("policy", "kept"), [(WALK_ON, 0.47), (RECOVER, 1.02)])
def test_the_captions_are_what_the_walks_do(policy: str, kept: float) -> None:
    assert speed_kept(walk_and_fail(policy, None)) == pytest.approx(kept, abs=0.03)


def test_the_picture_is_small_and_on_top_of_the_readme() -> None:
    assert PICTURE.stat().st_size < 3_000_000
    with Image.open(PICTURE) as gif:
        assert gif.size[0] == WIDTH_PX
        assert gif.n_frames > 10 * SHOWN_S / 2
    head = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()[:6]
    assert any("docs/images/rescue.gif" in line for line in head)
