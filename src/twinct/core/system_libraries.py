"""System libraries that wheels expect and do not bring, and the apt lines that install them.

``tools/system-libraries`` and README.md name the same packages.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from functools import cache

EGL = ("libegl1", "libgl1", "libgl1-mesa-dri", "libopengl0")
"""OpenGL with a software renderer, which draws without a display: MuJoCo's pictures, and gVXR."""

OPENMP = ("libgomp1",)
"""numba uses it, so that several threads may call kernels at once."""

X11 = (
    *("libice6", "libsm6", "libx11-6", "libxrender1", "libxcb-composite0", "libxcb-cursor0"),
    *("libxcb-ewmh2", "libxcb-icccm4", "libxcb-image0", "libxcb-keysyms1", "libxcb-render-util0"),
    *("libxcb-render0", "libxcb-res0", "libxcb-shape0", "libxcb-util1", "libxcb-xinerama0"),
    "libxcb-xkb1",
)
"""Client libraries of X11, which gVXR loads even without a display."""

ALL = (*EGL, *OPENMP, *X11)


def apt_line(packages: Iterable[str]) -> str:
    """Return the command that installs packages on Debian and Ubuntu."""
    return f"apt-get install --no-install-recommends {' '.join(packages)}"


@cache
def egl_is_there() -> bool:
    """Return True if EGL's library can be loaded; this takes less than a millisecond."""
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    return True
