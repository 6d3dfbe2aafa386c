"""Validation against the schema that the user has, without the network: imported schemas stand beside it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from bench.model.errors import InputError
from bench.model.extras import optional
from bench.report.dcc.elements import DCC, SI, VERSION, lines_of

_MAX_LISTED = 20


@dataclass(frozen=True)
class Violation:
    """A place where a certificate does not hold a schema: line of the file, path of the element, what is wrong."""

    line: int
    path: str
    reason: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.path}: {self.reason}"


class CertificateSchema:
    """A dcc.xsd with the schemas it imports, found by file name in its folder; that of signatures may be missing there.

    Raises: InputError B-DCC-008 (cannot be read, is of another version, or an imported schema is missing),
            B-DCC-010 (the package xmlschema is not installed).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        message = "the package xmlschema is not installed, so nothing can be validated"
        cure = "pip install 'inertial-bench[certificate]', or leave --schema out"
        package = optional("xmlschema", InputError("B-DCC-010", message, where="--schema", next_step=cure))
        _check_version(path)
        self._package = package
        signatures, missing = Path(package.__file__).parent / "schemas" / "DSIG", set[str]()

        def local(uri: object) -> str:
            """Return the file that stands for the address of a schema."""
            name = str(uri).rsplit("/", 1)[-1]
            for file in (path.parent / name, signatures / name):
                if file.is_file():
                    return file.resolve().as_uri()
            missing.add(name)
            return str(uri)

        broken: Exception | None = None
        with warnings.catch_warnings(record=True) as told:  # so that all that is missing is named at once
            warnings.simplefilter("always")
            try:
                self._schema: Any = package.XMLSchema(str(path), allow="local", uri_mapper=local)
            except (package.XMLSchemaException, OSError, ValueError) as error:
                broken = error
        if missing and (broken or told):  # else the package knows the namespace by itself
            names = ", ".join(sorted(missing))
            raise _unusable(path, f"imports what is not in its folder: {names}", f"put {names} beside it")
        if broken or told:
            first = (str(broken or told[0].message).splitlines() or ["?"])[0]
            raise _unusable(path, f"is not a usable schema: {first}", "fetch it again from its publisher") from broken

    def violations(self, text: str) -> list[Violation]:
        """Return what does not hold in a certificate, in the order of its lines."""
        root = ET.fromstring(text)
        lines = {id(element): line for element, line in zip(root.iter(), lines_of(text), strict=True)}
        resource = self._package.XMLResource(root, allow="none")
        return [
            Violation(lines.get(id(error.elem), 1), _short(str(error.path)), _short(str(error.reason)))
            for error in self._schema.iter_errors(resource)
        ]


def not_valid(violations: list[Violation], where: Path, schema: Path) -> InputError:
    """Return the error B-DCC-009 for a certificate that does not hold its schema; ``where`` it was written."""
    listed = "".join(f"\n  {violation}" for violation in violations[:_MAX_LISTED])
    more = len(violations) - _MAX_LISTED
    listed += f"\n  and {more} more" if more > 0 else ""
    return InputError(
        "B-DCC-009",
        f"does not hold {schema.name} in {len(violations)} places:{listed}",
        where=where,
        next_step="check that the schema is the published one; if it is, report this",
    )


def _short(text: str) -> str:
    """Return one line, with the prefixes of the certificate instead of its namespaces."""
    for prefix, space in (("dcc", DCC), ("si", SI)):
        text = text.replace(f"{{{space}}}", f"{prefix}:")
    return " ".join(text.split())


def _check_version(path: Path) -> None:
    """Refuse what is no schema, or one of another version."""
    try:
        root = ET.fromstring(path.read_bytes())
    except (OSError, ET.ParseError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise _unusable(path, f"cannot be read: {reason}", "name the file dcc.xsd") from error
    if root.tag != "{http://www.w3.org/2001/XMLSchema}schema":
        raise _unusable(path, "is not an XML schema", "name the file dcc.xsd")
    version = root.get("version")
    if version != VERSION:
        raise _unusable(path, f"is of version {version}", f"name the dcc.xsd of version {VERSION}")


def _unusable(path: Path, message: str, next_step: str) -> InputError:
    return InputError("B-DCC-008", message, where=path, next_step=next_step)
