"""Options of a prior or a repertoire, and the command that builds a session's prior."""

from typing import Any

import pytest

from hexctl.errors import InputError
from hexctl.study.priors.prior_options import PriorOptions


@pytest.mark.parametrize(
    ("options", "option"),
    [
        ({"directions": 4}, "directions"),
        ({"pairs": ()}, "pairs"),
        ({"repertoire": True, "failure": "limp"}, "failure"),
        ({"repertoire": True, "hold": "line"}, "hold"),
        ({"repertoire": True, "duration_s": 8.0}, "duration_s"),
        ({"hold": "auto"}, "hold"),
        ({"worlds": 1}, "worlds"),
        ({"duration_s": 5.0}, "duration_s"),
    ],
)
def test_what_a_prior_or_a_repertoire_does_not_take_is_refused(options: dict[str, Any], option: str) -> None:
    with pytest.raises(InputError, match=f"^{option}: got "):
        PriorOptions(**options)
