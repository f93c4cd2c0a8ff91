"""Print the size of twinct's dependencies and of each extra, as they are installed here.

    python benchmarks/extra_sizes.py

Writes a table in Markdown: packages and megabytes that an extra adds to twinct without extras.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

LEFT_OUT = ("dev", "docs")


def main() -> int:
    """Print the table, and return 1 if a package is not installed here."""
    missing = set[str]()
    base = closure("twinct", "", missing)
    rows = [("twinct", base)]
    for extra in distribution("twinct").metadata.get_all("Provides-Extra") or ():
        if extra not in LEFT_OUT:
            rows.append((f"`{extra}`", closure("twinct", extra, missing) - base))
    print("| extra | packages | MB installed |\n|---|---|---|")
    for name, packages in rows:
        print(f"| {name} | {len(packages)} | {sum(map(megabytes, packages)):.0f} |")
    if missing:
        print(f"not installed here: {', '.join(sorted(missing))}", file=sys.stderr)
    return 1 if missing else 0


def closure(name: str, extra: str, missing: set[str]) -> set[str]:
    """Return a package with all that it needs, by name; add what is absent to ``missing``."""
    found, waiting = set[tuple[str, str]](), [(name, ""), (name, extra)]
    while waiting:
        package = waiting.pop()
        if package in found:
            continue
        owner = installed(package[0])
        if owner is None:
            missing.add(package[0])
            continue
        found.add(package)
        for line in owner.requires or ():
            needed = Requirement(line)
            if needed.marker is None or needed.marker.evaluate({"extra": package[1]}):
                which = canonicalize_name(needed.name)
                waiting += [(which, ""), *((which, one) for one in needed.extras)]
    return {package for package, _ in found}


@cache
def installed(name: str) -> Distribution | None:
    """Return an installed package; None if there is none."""
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


@cache
def megabytes(name: str) -> float:
    """Return the size of a package's files on disk, MB, without compiled Python."""
    owner = installed(name)
    files = (owner and owner.files) or ()
    paths = [Path(str(file.locate())) for file in files if ".pyc" not in file.name]
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


if __name__ == "__main__":
    sys.exit(main())
