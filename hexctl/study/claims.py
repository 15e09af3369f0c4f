"""The paper's claims, each with its rule, and what came of it here."""

from collections.abc import Callable

from hexctl.study.claim import Claim
from hexctl.study.findings import Findings
from hexctl.study.search_claims import (
    best_keep_line,
    competitive,
    converges,
    fast_then_flat,
    minimal_by_60,
    ten_cm_by_20,
)
from hexctl.study.walk_claims import goes_both_ways, rotation_helps, veers_left, veers_right


def claims_of(findings: Findings) -> list[Claim]:
    """Return all claims, in the paper's order."""
    makers: list[Callable[[Findings], Claim]] = [
        veers_left,
        veers_right,
        goes_both_ways,
        rotation_helps,
        converges,
        fast_then_flat,
        minimal_by_60,
        ten_cm_by_20,
        competitive,
        best_keep_line,
    ]
    return [make(findings) for make in makers]
