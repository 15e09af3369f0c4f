from pathlib import Path

from hexctl.study.report_page import Block, Bullets, Picture, Section, Table, render_page

HOSTILE = '<script>alert("a & b")</script>'


def test_every_text_is_escaped(tmp_path: Path) -> None:
    image = tmp_path / "a<b.svg"
    image.write_bytes(b"svg")
    blocks: list[Block] = [
        HOSTILE,
        Bullets([HOSTILE]),
        Table([HOSTILE], [[HOSTILE]]),
        Picture(image, HOSTILE, HOSTILE),
    ]
    text = render_page(HOSTILE, HOSTILE, [Section(HOSTILE, blocks)])
    assert text.count("<script") == 1
    assert HOSTILE not in text
    assert text.count("&lt;script&gt;") >= 9
    assert "a<b" not in text


def test_verdicts_are_coloured_and_nothing_else_is() -> None:
    row = ["holds", "does not hold, by 2 cm", "not measured", "not judged: too short", "it holds", ""]
    text = render_page("", "", [Section("", [Table(["holds"] * 6, [row])])])
    assert '<td class="yes">holds</td>' in text
    assert '<td class="no">does not hold, by 2 cm</td>' in text
    assert '<td class="open">not judged: too short</td>' in text
    assert text.count('<td class="') == 3


def test_a_section_without_a_title_has_no_heading() -> None:
    text = render_page("title", "heading", [Section("", ["a"]), Section("named", ["b"])])
    assert text.count("<h2") == 1
    assert text.index("<h1>heading</h1>") < text.index("<p>a</p>") < text.index('<h2 id="named">')
