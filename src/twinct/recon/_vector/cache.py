"""Disk cache of compiled kernels, one folder for all their sources.

numba checks the file of a kernel alone, not the files of functions that it calls. Code that numba
compiled in the running process also differs in the last bits from code that it later loads from
disk: there, LLVM has optimised inner loops once more, and fast mathematics reorders sums. Kernels
are therefore compiled in a separate process, into a folder named after their sources and the
compiler, and always loaded from there. Other cached kernels are neither read nor removed.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import llvmlite
import numba
from llvmlite.binding import get_host_cpu_features, get_host_cpu_name
from numba.core import config as numba_config

from twinct.core.files.private import private_folder, temporary_folder
from twinct.recon.blocks import EDGE

log = logging.getLogger(__name__)

config: Any = numba_config  # its names are created at import

_HERE = Path(__file__).parent
OTHERS = ("recon/_linear", "recon/_plain", "recon/_variation", "rays/joseph")
"""Modules of twinct whose functions the kernels call, beside their own folder."""

_COMPILING = "TWINCT_COMPILING"
"""Environment variable of the process that compiles: its folder."""


@contextlib.contextmanager
def kernels_from_disk() -> Iterator[None]:
    """Load kernels that are imported in this block from their folder, compiled if necessary.

    Raises:
        RuntimeError: the kernels do not compile; with the compiler's last line.
    """
    before = config.CACHE_DIR
    config.CACHE_DIR = os.environ.get(_COMPILING) or str(_folder())
    try:
        yield
    finally:
        config.CACHE_DIR = before


def _folder() -> Path:
    """Return the folder of the kernels, and compile them first if necessary."""
    name = f"kernels-{_digest()}"
    if config.CACHE_DIR:
        places = [Path(config.CACHE_DIR)]
    else:
        own = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        places = [_HERE / "__pycache__", own / "twinct"]
    for place in places:
        if (place / name).is_dir():
            return place / name
    for place in places:
        with contextlib.suppress(OSError):
            place.mkdir(parents=True, exist_ok=True)
            with private_folder(place) as draft:
                return _compiled(draft / name, place / name)
    log.info(
        "cannot keep the compiled kernels, because no folder is writable: %s",
        ", ".join(map(str, places)),
    )
    stack = contextlib.ExitStack()
    atexit.register(stack.close)
    passing = stack.enter_context(temporary_folder())
    return _compiled(passing / f"draft-{name}", passing / name)


def _digest() -> str:
    """Return the digest of everything that compiled kernels depend on."""
    others = (_HERE.parents[1] / f"{name}.py" for name in OTHERS)
    sources = sorted([*_HERE.glob("*.py"), *others])
    parts = [source.read_bytes() for source in sources]
    # numba also distinguishes sources by their location.
    machine = (str(_HERE), sys.version, numba.__version__, llvmlite.__version__, config.OPT, EDGE)
    processor = (get_host_cpu_name(), get_host_cpu_features().flatten())
    chosen = (config.CPU_NAME, config.CPU_FEATURES)
    parts += [repr(part).encode() for part in (machine, processor, chosen)]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def _compiled(draft: Path, folder: Path) -> Path:
    """Compile into a draft folder, and rename it."""
    # At this level, because the terminal is silent meanwhile; nothing is wrong.
    log.warning(
        "first run: compiling the reconstruction kernels, which takes half a minute (into %s)",
        folder,
        extra={"notice": True},
    )
    draft.mkdir()
    result = subprocess.run(
        # -P: import the same modules as this process, not modules in the current folder.
        [sys.executable, "-P", "-c", "import twinct.recon._vector"],
        env=os.environ | {_COMPILING: str(draft), "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
    )
    if result.returncode:
        lines = result.stderr.strip().splitlines() or ["no reason given"]
        raise RuntimeError(lines[-1])
    with contextlib.suppress(OSError):  # another process was faster, with the same kernels
        draft.rename(folder)
    return folder
