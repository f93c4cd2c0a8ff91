"""Check that everything that states the version agrees, before a release.

    python tools/check_release.py v1.0.0

Compares the tag with the version of the package, the citation, the Zenodo file, the conda recipe,
and the changelog. Refuses a release whose addresses are still placeholders. Without a tag, only the
versions are compared.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import yaml

from twinct.version import __version__

ROOT = Path(__file__).parents[1]


def main(arguments: list[str]) -> int:
    """Print what keeps this from being a release, and return 1 if anything does."""
    problems = [*versions(), *(release(arguments[0]) if arguments else ())]
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


def versions() -> Iterator[str]:
    """Yield a sentence for each file that states another version."""
    stated = {
        "CITATION.cff": str(_yaml("CITATION.cff")["version"]),
        ".zenodo.json": json.loads(_text(".zenodo.json"))["version"],
        "packaging/conda/recipe.yaml": _yaml("packaging/conda/recipe.yaml")["context"]["version"],
    }
    for file, version in stated.items():
        if version != __version__:
            yield f"{file}: version {version}; src/twinct/version.py says {__version__}"


def release(tag: str) -> Iterator[str]:
    """Yield a sentence for each reason not to release under a tag."""
    if tag != f"v{__version__}":
        yield f"tag {tag}: src/twinct/version.py says {__version__}, so the tag is v{__version__}"
    for name, url in tomllib.loads(_text("pyproject.toml"))["project"]["urls"].items():
        if re.match(r"https://[^/]*\.example/", url):
            yield f"pyproject.toml: project.urls.{name}: {url} is a placeholder"
    heading = rf"^## {re.escape(__version__)} - \d{{4}}-\d\d-\d\d$"
    if not re.search(heading, _text("CHANGELOG.md"), re.MULTILINE):
        yield f"CHANGELOG.md: no section '## {__version__} - DATE'"


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _yaml(name: str) -> dict:
    return yaml.safe_load(_text(name))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
