"""A store of objects in memory, URL ``away://...``, whose package raises errors of its own when it does not answer."""

from typing import Any, ClassVar

import fsspec
from fsspec.implementations.memory import MemoryFileSystem


class NoAnswer(Exception):
    """As packages of fsspec raise: an error of their own that is no OSError."""


class Away(MemoryFileSystem):  # type: ignore[misc]
    """A store that answers until ``fails`` names what it does not any more."""

    protocol = "away"
    fails: ClassVar[str] = ""

    def _answer(self, call: str) -> None:
        if call == self.fails:
            raise NoAnswer("could not connect to\nthe endpoint")

    def find(self, *words: Any, **options: Any) -> Any:
        self._answer("find")
        return super().find(*words, **options)

    def ls(self, *words: Any, **options: Any) -> Any:
        self._answer("ls")
        return super().ls(*words, **options)

    def get_file(self, *words: Any, **options: Any) -> None:
        self._answer("get_file")
        super().get_file(*words, **options)

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return str(MemoryFileSystem._strip_protocol(path.replace("away:", "memory:")))


fsspec.register_implementation("away", Away, clobber=True)
