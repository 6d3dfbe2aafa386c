"""Fonts of paper and figures: DejaVu Sans, which comes with matplotlib, and behind it one with Korean letters.

The second one, NanumGothic, comes with the extra 'ko'. Its package is found and never imported: it would change the
settings of matplotlib for everybody.
"""

from __future__ import annotations

import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from bench.model.errors import InputError

_FILES = {False: "DejaVuSans.ttf", True: "DejaVuSans-Bold.ttf"}
_KOREAN_FILES = {False: "NanumGothic.ttf", True: "NanumGothicBold.ttf"}
_FAMILY, _KOREAN_FAMILY = "DejaVu Sans", "NanumGothic"
_KOREAN_PACKAGE = "koreanize_matplotlib"
_EAST_ASIA = re.compile("[\u1100-\u11ff\u3000-\ud7ff]")
_WITH_FONT = ("ko",)  # languages that need the second font


def folders() -> list[Path]:
    """Return the folders of the font files, that of the Korean font last and only if it is installed."""
    import matplotlib as mpl

    korean = _korean_folder()
    return [Path(mpl.get_data_path()) / "fonts" / "ttf", *([] if korean is None else [korean])]


def families() -> list[str]:
    """Return the families; a character is drawn by the first one that has it."""
    return [_FAMILY, *(_KOREAN_FAMILY for _ in korean_files())]


def in_first_font(text: str) -> bool:
    """Return whether a text has no letter of East Asia, so that the first family draws all that any of them can."""
    return _EAST_ASIA.search(text) is None


def font_files(bold: bool) -> list[Path]:
    """Return the files of one weight, in the order of the families."""
    names = (_FILES[bold], _KOREAN_FILES[bold])
    return [folder / name for folder, name in zip(folders(), names, strict=False)]


def korean_files() -> list[Path]:
    """Return the file of the Korean font in its normal weight; [] if it is not installed."""
    folder = _korean_folder()
    return [] if folder is None else [folder / _KOREAN_FILES[False]]


def check_font(language: str) -> None:
    """Refuse a language for paper that no installed font can print. Raises: InputError B-TXT-002."""
    if language in _WITH_FONT and _korean_folder() is None:
        raise InputError(
            "B-TXT-002",
            f"paper in the language {language!r} needs a font that is not installed",
            where="--pdf",
            next_step=f"pip install 'inertial-bench[{language}]'; the page needs no font of its own",
        )


@cache
def _korean_folder() -> Path | None:
    spec = find_spec(_KOREAN_PACKAGE)
    places = [] if spec is None else spec.submodule_search_locations or []
    folders = [Path(place) / "fonts" for place in places]
    return next((folder for folder in folders if (folder / _KOREAN_FILES[False]).is_file()), None)
