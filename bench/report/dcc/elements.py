"""XML elements of a certificate: namespaces, plain text, lists, and the text of the whole with its line numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from xml.etree import ElementTree as ET

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
XSI = "http://www.w3.org/2001/XMLSchema-instance"
VERSION = "3.2.1"
LANGUAGE = "en"
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_START_TAG = re.compile(r"<(?=[A-Za-z])")

Element = ET.Element


def dcc(tag: str, *children: Element | None, text: str | None = None, **attributes: str | None) -> Element:
    """Return an element of the certificate; None among children and attributes is left out."""
    return _element(DCC, tag, children, text, attributes)


def si(tag: str, *children: Element | None, text: str | None = None) -> Element:
    """Return an element of the D-SI format."""
    return _element(SI, tag, children, text, {})


def words(tag: str, text: str, **attributes: str | None) -> Element:
    """Return an element whose content is a text in the language of the certificate."""
    return dcc(tag, dcc("content", text=text, lang=LANGUAGE), **attributes)


def number_list(values: Iterable[str], unit: str) -> Element:
    """Return numbers of one D-SI unit."""
    return si("realListXMLList", si("valueXMLList", text=" ".join(values)), si("unitXMLList", text=unit))


def leaf(tag: str, text: object | None) -> Element | None:
    """Return an element that holds one plain text; none for None or an empty text."""
    plain = "" if text is None else plain_text(str(text))
    return dcc(tag, text=plain) if plain else None


def plain_text(text: str) -> str:
    """Return text in one line, without what XML cannot hold; the schema wants no space at its ends."""
    return " ".join(_NOT_XML.sub(" ", text).split())


def _element(
    space: str, tag: str, children: Iterable[Element | None], text: str | None, attributes: dict[str, str | None]
) -> Element:
    made = ET.Element(f"{{{space}}}{tag}", {name: value for name, value in attributes.items() if value is not None})
    made.extend(child for child in children if child is not None)
    if text is not None:
        made.text = plain_text(text)
    return made


def document_text(root: Element) -> str:
    """Return the whole document, one element a line, the same for the same elements."""
    for prefix, space in (("dcc", DCC), ("si", SI), ("xsi", XSI)):
        ET.register_namespace(prefix, space)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def lines_of(text: str) -> list[int]:
    """Return line of each element of a text, in document order, counted from 1."""
    lines, line, at = [], 1, 0
    for match in _START_TAG.finditer(text):
        line += text.count("\n", at, match.start())
        at = match.start()
        lines.append(line)
    return lines
