"""Sphinx extension: run the programs of the gallery in one folder, show the pictures they write."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

from sphinx_gallery import gen_rst
from sphinx_gallery.scrapers import figure_rst

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build" / "gallery"
_shown: set[tuple[Path, int]] = set()


def pictures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Return the reST of pictures that a block of a program wrote."""
    found = []
    for picture in sorted(WORK.glob("*.png"), key=lambda path: path.stat().st_mtime_ns):
        key = (picture, picture.stat().st_mtime_ns)
        if key not in _shown:
            _shown.add(key)
            shown = Path(next(block_vars["image_path_iterator"]))
            shutil.copyfile(picture, shown)
            found.append(shown)
    return figure_rst(found, gallery_conf["src_dir"])


def setup(app: Any) -> dict[str, bool]:
    """Let programs run where ``scenarios/`` is, and not between their sources.

    Sphinx-Gallery goes to the folder of a source before each block and has no setting for it.
    """
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    (WORK / "scenarios").symlink_to(ROOT / "scenarios")
    execute = gen_rst._exec_and_get_memory

    def executed(*args: Any, **named: Any) -> Any:
        os.chdir(WORK)
        return execute(*args, **named)

    gen_rst._exec_and_get_memory = executed
    return {"parallel_read_safe": True, "parallel_write_safe": True}
