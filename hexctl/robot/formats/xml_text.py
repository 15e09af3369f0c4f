"""XML of robot descriptions: elements with attributes, numbers with all digits, indented text."""

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from hexctl.palette import Color


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
