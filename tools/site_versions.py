"""Write what stands above the versions of the published site: their list, and a first page.

python tools/site_versions.py FOLDER /address/of/the/site
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

PAGE = (
    '<!DOCTYPE html><meta http-equiv="refresh" content="0; url={url}"><a href="{url}">twinct</a>\n'
)


def versions(folder: Path) -> list[str]:
    """Return the versions that a folder holds: dev first, then the newest release."""
    found = [page.parent.name for page in folder.glob("*/index.html")]
    return sorted(found, key=lambda name: (name == "dev", _numbers(name)), reverse=True)


def _numbers(name: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", name)]


def write(folder: Path, root: str) -> None:
    """Write switcher.json and index.html; the page leads to the newest release, if there is one."""
    found = versions(folder)
    releases = [name for name in found if name != "dev"]
    newest = (releases or found)[0]
    entries = [
        {"name": name, "version": name, "url": f"{root}/{name}/", "preferred": name == newest}
        for name in found
    ]
    (folder / "switcher.json").write_text(json.dumps(entries, indent=2) + "\n", encoding="utf-8")
    (folder / "index.html").write_text(PAGE.format(url=f"{root}/{newest}/"), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]), sys.argv[2].rstrip("/"))
