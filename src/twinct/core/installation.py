"""Command that adds extras to twinct, from the place that it was installed from."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote, urlsplit

PLACE_LOST = "the folder of the repository, or the wheel"


def install_command(extras: Iterable[str], *options: str) -> str:
    """Return the command of pip that installs extras; ``options`` stand before the package.

    twinct may be on no package index. pip notes the folder or the wheel that it installed from
    (PEP 610, ``direct_url.json``), and this is where the extras are.
    """
    place, editable = installed_from()
    wanted = f"{place}[{','.join(extras)}]"
    flags = [*options, *(["-e"] if editable else [])]
    return " ".join(["python -m pip install", *flags, f"'{wanted}'"])


def installed_from() -> tuple[str, bool]:
    """Return what pip takes twinct from, and whether as an editable folder.

    A folder or wheel that is gone is named in words, and a package of an index by its name.
    """
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        note = json.loads(distribution("twinct").read_text("direct_url.json") or "{}")
        url = note.get("url", "")
        editable = bool(note.get("dir_info", {}).get("editable"))
    except (PackageNotFoundError, ValueError, AttributeError):
        url, editable = "", False
    if not isinstance(url, str) or not url:
        return "twinct", False
    if not url.startswith("file:"):
        return f"twinct @ {url}", False
    path = Path(unquote(urlsplit(url).path))
    return (str(path), editable) if path.exists() else (PLACE_LOST, False)
