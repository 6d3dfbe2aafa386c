"""Writes the facts of the schema as an XSD, and checks a certificate against it with a validator of another project."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from dcc_facts import BUILT_IN, DCC_TYPES, LISTS, NAMESPACES, PATTERNS, SCHEMA_VERSION, SI_TYPES, WORDS
from xmlschema import XMLSchema

_TOKEN = re.compile(r"(\w+):(\w+)([?*+]?)")
_IDS = {"id": "ID", "refId": "IDREFS", "refType": "refTypes", "lang": "language", "schemaVersion": "version"}


@cache
def _schema() -> XMLSchema:
    with TemporaryDirectory() as folder:
        Path(folder, "SI_Format.xsd").write_text(xsd("si"))
        return XMLSchema(xsd("dcc", "SI_Format.xsd"), base_url=folder)


def problems(xml: bytes) -> list[str]:
    """What a validator of another project finds against the facts; empty for a certificate that is in order."""
    return [f"{error.path}: {error.reason}" for error in _schema().iter_errors(xml.decode())]


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
