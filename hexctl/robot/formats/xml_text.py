"""XML: elements with attributes, numbers with all digits, indented text, and safe reading."""

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from hexctl.palette import Color

#: Maximum number of elements of a file; each takes a hundred times the memory of its text.
MOST_ELEMENTS = 200_000


class _PlainBuilder(ElementTree.TreeBuilder):
    def __init__(self) -> None:
        super().__init__()
        self._count = 0

    def start(self, tag: str, attributes: dict[str, str]) -> Element:
        self._count += 1
        if self._count > MOST_ELEMENTS:
            raise ValueError(f"has more than {MOST_ELEMENTS} elements")
        return super().start(tag, attributes)

    def doctype(self, *_: object) -> None:
        raise ValueError("has a DOCTYPE, which may declare entities")


def parse_xml(content: bytes) -> Element:
    """Root of an XML file in any encoding.

    Raises ValueError for no XML, a DOCTYPE (entity attacks), or too many elements.
    """
    try:
        return ElementTree.fromstring(content, ElementTree.XMLParser(target=_PlainBuilder()))  # noqa: S314
    except (ElementTree.ParseError, LookupError) as error:  # a LookupError is an unknown encoding
        raise ValueError(f"is not XML ({error})") from error


def add(parent: Element, tag: str, **attributes: str) -> Element:
    """Add an element with attributes to another one."""
    return SubElement(parent, tag, attributes)


def number(value: float) -> str:
    """The shortest text that gives the same number again."""
    return repr(float(value))


def numbers(*values: float) -> str:
    """Numbers with spaces between them."""
    return " ".join(map(number, values))


def color_text(color: Color) -> str:
    """Red, green and blue, 0 to 1."""
    return numbers(*(round(part / 255, 4) for part in color))


def text_of(root: Element) -> str:
    """Indented text; its declaration names no encoding, which lxml would refuse."""
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
