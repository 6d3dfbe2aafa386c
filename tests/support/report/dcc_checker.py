"""Checks a certificate against the facts of the schema, and writes those facts as an XSD for another validator."""

import re
from collections.abc import Iterator
from xml.etree import ElementTree as ET

from dcc_facts import BUILT_IN, DCC_TYPES, LISTS, NAMESPACES, PATTERNS, SCHEMA_VERSION, SI_TYPES, WORDS

_TOKEN = re.compile(r"(\w+):(\w+)([?*+]?)")
_IDS = {"id": "ID", "refId": "IDREFS", "refType": "refTypes", "lang": "language", "schemaVersion": "version"}
_SPACES = {uri: prefix for prefix, uri in NAMESPACES.items()}


def problems(xml: bytes) -> list[str]:
    """What does not hold, with the path of the element; empty for a certificate that is in order."""
    root = ET.fromstring(xml)
    found = [] if root.get("schemaVersion") == SCHEMA_VERSION else [f"schemaVersion {root.get('schemaVersion')}"]
    if root.tag != f"{{{NAMESPACES['dcc']}}}digitalCalibrationCertificate":
        found.append(f"root {root.tag}")
    found += _element(root, "dcc", "digitalCalibrationCertificate", "/")
    ids = [one.get("id") for one in root.iter() if one.get("id") is not None]
    found += [f"id {one} twice" for one in sorted(set(ids)) if ids.count(one) > 1]
    wanted = {ref for one in root.iter() for ref in one.get("refId", "").split()}
    return found + [f"refId {one} is nowhere" for one in sorted(wanted - set(ids))]


def _element(element: ET.Element, space: str, kind: str, path: str) -> Iterator[str]:
    types = DCC_TYPES if space == "dcc" else SI_TYPES
    if kind not in types or not types[kind][0]:
        yield from _simple(element, kind, path)
    model, attributes = types.get(kind, ("", ""))
    allowed = {name.rstrip("!") for name in attributes.split()}
    own = (name for name in element.attrib if not name.startswith("{"))
    yield from (f"{path}: attribute {name}" for name in own if name not in allowed)
    if model:
        yield from _children(element, space, model, path)


def _children(element: ET.Element, space: str, model: str, path: str) -> Iterator[str]:
    children = [(_SPACES.get(one.tag[1:].partition("}")[0], "?"), one.tag.partition("}")[2]) for one in element]
    named = {name: (prefix, kind) for prefix, name, kind in _named(space, model)}
    sequence = "".join(f"{name};" for _, name in (sorted(children) if model[0] == "&" else children))
    if not re.fullmatch(_pattern(model), sequence):
        yield f"{path}: children {sequence}"
    if (element.text or "").strip():
        yield f"{path}: text between elements"
    for index, (child, (prefix, name)) in enumerate(zip(element, children, strict=True)):
        if named.get(name, ("", ""))[0] == prefix:
            yield from _element(child, prefix, named[name][1], f"{path}/{name}[{index}]")
        else:
            yield f"{path}: {prefix}:{name} is not known here"


def _named(space: str, model: str) -> Iterator[tuple[str, str, str]]:
    for name, kind, _ in _TOKEN.findall(model):
        yield ("si", kind, kind) if name == "si" else (space, name, kind)


def _pattern(model: str) -> str:
    """A regular expression over the names of the children; of any order: over the sorted names."""
    if model[0] == "&":
        model = " ".join(sorted(model[1:].split()))
    as_names = _TOKEN.sub(lambda match: f"(?:{match[2] if match[1] == 'si' else match[1]};){match[3]}", model)
    return as_names.replace(" ", "")


def _simple(element: ET.Element, kind: str, path: str) -> Iterator[str]:
    text = element.text or ""
    if len(element):
        yield f"{path}: has children"
    for word in text.split() if kind in LISTS else [text]:
        item = LISTS.get(kind, kind)
        if item in PATTERNS and not re.fullmatch(PATTERNS[item], word):
            yield f"{path}: {word!r} is no {item}"
        if item in WORDS and word not in WORDS[item].split():
            yield f"{path}: {word!r} is none of {WORDS[item]}"
    if kind in LISTS and not text.split():
        yield f"{path}: empty list"


def xsd(space: str, imported: str = "") -> str:
    """The facts of one namespace as a schema; ``imported``: where the schema of D-SI is said to be."""
    types = DCC_TYPES if space == "dcc" else SI_TYPES
    root = "digitalCalibrationCertificate" if space == "dcc" else ""
    parts = [f'<xs:import namespace="{NAMESPACES["si"]}" schemaLocation="{imported}"/>'] if space == "dcc" else []
    parts += [f'<xs:element name="{name}" type="{space}:{name}Type"/>' for name in ([root] if root else types)]
    parts += [_complex(space, name, *types[name]) for name in types]
    parts += [*_simple_types(space), f'<xs:simpleType name="versionType"><xs:restriction base="xs:string">'
              f'<xs:enumeration value="{SCHEMA_VERSION}"/></xs:restriction></xs:simpleType>']  # fmt: skip
    for other in ("anything", "xml", "relativeUncertainty"):
        parts.append(f'<xs:complexType name="{other}Type"><xs:sequence><xs:any minOccurs="0" maxOccurs="unbounded" '
                     'processContents="lax"/></xs:sequence></xs:complexType>')  # fmt: skip
    if space == "si":
        others = ("hybrid", "complex", "constant", "list")
        parts += [f'<xs:element name="{name}" type="si:anythingType"/>' for name in others]
    spaces = " ".join(f'xmlns:{prefix}="{uri}"' for prefix, uri in NAMESPACES.items())
    return (
        f'<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" {spaces} targetNamespace="{NAMESPACES[space]}" '
        f'elementFormDefault="qualified" version="{SCHEMA_VERSION if space == "dcc" else "2.1.0"}">'
        + "\n".join(parts) + "</xs:schema>"
    )  # fmt: skip


def _complex(space: str, name: str, model: str, attributes: str) -> str:
    listed = "".join(
        f'<xs:attribute name="{one.rstrip("!")}" type="{_attribute(space, one.rstrip("!"))}" '
        f'use="{"required" if one.endswith("!") else "optional"}"/>'
        for one in attributes.split()
    )
    if not model:
        base = f"{space}:{name}Words" if name in WORDS else "xs:string"
        return (f'<xs:complexType name="{name}Type"><xs:simpleContent><xs:extension base="{base}">{listed}'
                "</xs:extension></xs:simpleContent></xs:complexType>")  # fmt: skip
    return f'<xs:complexType name="{name}Type">{_group(space, model)}{listed}</xs:complexType>'


def _attribute(space: str, name: str) -> str:
    kind = _IDS[name]
    return f"xs:{kind}" if kind.startswith("ID") else f"{space}:{kind}Type"


def _group(space: str, model: str) -> str:
    if model[0] == "&":
        return f"<xs:all>{_particles(space, model[1:])}</xs:all>"
    return f"<xs:sequence>{_particles(space, model)}</xs:sequence>"


def _particles(space: str, model: str) -> str:
    text = _TOKEN.sub(lambda match: _particle(space, *match.groups()), model)
    text = re.sub(r"\)([?*+]?)", lambda match: "</xs:choice>" + (f"<!--{match[1]}-->" if match[1] else ""), text)
    text = text.replace("(", "<xs:choice>").replace("|", "")
    return re.sub(
        r"<xs:choice>((?:(?!<xs:choice>).)*?)</xs:choice><!--(.)-->",
        lambda match: f"<xs:choice{_often(match[2])}>{match[1]}</xs:choice>", text,
    )  # fmt: skip


def _particle(space: str, name: str, kind: str, often: str) -> str:
    if name == "si":
        return f'<xs:element ref="si:{kind}"/>'
    known = f"xs:{BUILT_IN[kind]}" if kind in BUILT_IN and kind != "stringWithLang" else f"{space}:{kind}Type"
    return f'<xs:element name="{name}" type="{known}"{_often(often)}/>'


def _often(often: str) -> str:
    least, most = ' minOccurs="0"', ' maxOccurs="unbounded"'
    return {"": "", "?": least, "*": least + most, "+": most}[often]


def _simple_types(space: str) -> Iterator[str]:
    for name, pattern in PATTERNS.items():
        base = {"boolean": "xs:boolean", "date": "xs:date"}.get(name, "xs:string")
        yield (f'<xs:simpleType name="{name}Type"><xs:restriction base="{base}"><xs:pattern value="{pattern}"/>'
               "</xs:restriction></xs:simpleType>")  # fmt: skip
    for name, words in WORDS.items():
        ending = "Words" if name == "performanceLocation" else "Type"
        choices = "".join(f'<xs:enumeration value="{word}"/>' for word in words.split())
        yield (f'<xs:simpleType name="{name}{ending}"><xs:restriction base="xs:string">{choices}'
               "</xs:restriction></xs:simpleType>")  # fmt: skip
    for name, item in LISTS.items():
        known = f"xs:{BUILT_IN[item]}" if item in BUILT_IN else f"{space}:{item}Type"
        yield f'<xs:simpleType name="{name}Type"><xs:list itemType="{known}"/></xs:simpleType>'
    yield '<xs:simpleType name="refTypesType"><xs:list itemType="xs:string"/></xs:simpleType>'
