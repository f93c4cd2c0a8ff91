"""Build the source distribution, and the wheel from it, without a network.

    python tools/build_dist.py DIR

What git tracks or does not ignore is built, from a copy, so that no earlier build gets in.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
_BUILD = "import sys; from setuptools import build_meta; print(build_meta.build_{}(sys.argv[1]))"


def main(arguments: list[str]) -> int:
    """Build both into a folder, and print their paths."""
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    for file in build(Path(arguments[0])):
        print(file)
    return 0


def build(out: Path) -> tuple[Path, Path]:
    """Return the source distribution and the wheel, built into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        source = Path(work, "source")
        for file in _sources():
            (source / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / file, source / file, follow_symlinks=False)
        sdist = _built("sdist", source, out)
        with tarfile.open(sdist) as archive:
            archive.extractall(work, filter="data")
        return sdist, _built("wheel", Path(work, sdist.name.removesuffix(".tar.gz")), out)


def _sources() -> list[Path]:
    """Return the files to build from: all of an unpacked source distribution, too."""
    if not (ROOT / ".git").exists():
        return [path.relative_to(ROOT) for path in ROOT.rglob("*") if path.is_file()]
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [Path(name) for name in names.split("\0") if name]
    return [file for file in files if (ROOT / file).exists()]


def _built(kind: str, source: Path, out: Path) -> Path:
    result = subprocess.run(
        [sys.executable, "-P", "-c", _BUILD.format(kind), str(out.resolve())],
        cwd=source,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        stdout=subprocess.PIPE,
        text=True,
    )
    if result.returncode:
        raise SystemExit(f"the {kind} cannot be built")
    return out / result.stdout.split()[-1]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
