"""Build step: the README for a package index, whose pages resolve no links into the repository.

Everything else stands in ``pyproject.toml``.
"""

import re
import tomllib
from pathlib import Path

from setuptools import setup

HERE = Path(__file__).parent
_HERE_ONLY = r"(?![a-z][a-z+.-]*:|#)"
_PICTURE = re.compile(rf"(!\[[^\[\]]*\]\(){_HERE_ONLY}")
_LINK = re.compile(rf"(\]\(){_HERE_ONLY}")
_TAG = re.compile(rf"(<(img|source|a)\b[^>]*?\b(?:src|href|srcset)=\"){_HERE_ONLY}")


def readme_for_index() -> str:
    """Return README.md with absolute links: pictures to their bytes, other files to their pages."""
    with (HERE / "pyproject.toml").open("rb") as file:
        source = tomllib.load(file)["project"]["urls"]["Source"]
    page, raw = f"{source}/blob/main/", f"{source}/raw/main/"
    text = (HERE / "README.md").read_text(encoding="utf-8")
    text = _LINK.sub(rf"\1{page}", _PICTURE.sub(rf"\1{raw}", text))
    return _TAG.sub(lambda m: m[1] + (page if m[2] == "a" else raw), text)


setup(long_description=readme_for_index(), long_description_content_type="text/markdown")
