"""Verdicts as lines of text."""

from hexctl.study.paper.evidence import Bar, bar_lines


def test_verdicts_stand_in_a_column_and_each_reason_once_below() -> None:
    why = "walks of 2 s, needs at least 20 s"
    bars = [
        Bar(name="a", asked="straight", measured="1 cm", holds=True),
        Bar(name="b", asked="fast", measured="0.1 m/s", holds=False),
        Bar(name="c", asked="steady", measured="not measured", holds=None, not_judged=why),
        Bar(name="d", asked="level", measured="not measured", holds=None, not_judged=why),
    ]
    lines = bar_lines(bars)
    verdicts = [line[:16].rstrip() for line in lines[:4]]
    assert verdicts == ["holds", "does not hold", "not judged", "not judged"]
    assert [line[16:] for line in lines[:2]] == ["straight: 1 cm", "fast: 0.1 m/s"]
    assert lines[4:] == [f"not judged: {why}"]
