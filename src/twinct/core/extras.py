"""Packages of each extra, and one check, before any work, that they are installed."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from twinct.core.errors import InputError, MissingExtraError
from twinct.core.installation import install_command

_IMPORTED: dict[str, tuple[str, ...]] = {
    "robots": ("mujoco", "mink", "daqp", "ruckig", "ompl"),
    "rtk": ("itk",),
    "cuda": ("warp",),
    "record": ("mcap.writer", "mcap_ros2.writer", "zstandard"),
    "study": ("pandas", "pyarrow.parquet"),
    "xacro": ("xacro", "xacro.substitution_args"),
    "ros": (
        *("rclpy", "rclpy.node", "geometry_msgs.msg", "sensor_msgs.msg", "std_msgs.msg"),
        *("trajectory_msgs.msg", "std_srvs.srv"),
        *("diagnostic_msgs.msg", "rosgraph_msgs.msg", "builtin_interfaces.msg"),
    ),
}
"""Modules that are cheap to import. They are imported, since an installed module may be broken."""

_FOUND: dict[str, tuple[str, ...]] = {
    "robots": ("coacd",),
    "xray": ("gvxrPython3",),
    "study": ("optuna",),
    "hdf5": ("h5py",),
    "planning": ("cmaes", "gymnasium"),
    "torch": ("torch",),
    "cluster": ("ray",),
    "view": ("viser", "mjviser", "imageio_ffmpeg", "fast_simplification"),
}
"""Modules that are only looked up, since their import is expensive.

gVXR takes seconds and 2 GB, and belongs to one thread. Ray and Optuna take seconds, and Ray reads
its environment when it is imported.
"""

_CALLED = {
    "gvxrPython3": "gvxr",
    "itk": "itk-rtk",
    "warp": "warp-lang",
    "mcap_ros2": "mcap-ros2-support",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "fast_simplification": "fast-simplification",
}
"""Names of modules in pip, where they differ."""

WAY_OUT = {
    "hdf5": "or store the images as .npy or Zarr",
    "cuda": "or use the engines vector and mesh, which need no card",
    "ros": "or use the link local (--link local)",
    "torch": "or use twinct.recon.Projector, which needs only NumPy",
    "rtk": "or use reconstruction.algorithm: sart",
    "xray": "or scan with the engine mesh (--set xray.engine=mesh)",
    "xacro": "or expand the file with ROS's xacro",
}
"""Alternatives to an extra."""


def require(*extras: str) -> None:
    """Make sure that extras are installed and can be imported.

    Args:
        extras: names of extras in ``pyproject.toml``.

    Raises:
        MissingExtraError: packages are missing; the message names all of them, and alternatives.
        InputError: an installed package cannot be imported; also if others are missing, too.
    """
    missing: dict[str, list[str]] = {}
    broken: list[str] = []
    for extra in extras:
        for module in (*_FOUND.get(extra, ()), *_IMPORTED.get(extra, ())):
            package = module.partition(".")[0]
            name = _CALLED.get(package, package)
            problem = _problem(module, installed_only=module in _FOUND.get(extra, ()))
            if problem is None or name in missing.get(extra, ()):
                continue
            if problem and extra in missing:
                continue  # it may fail for want of those
            if problem:
                broken.append(
                    f"{name} is installed but cannot be imported ({problem}): install it again "
                    f"with {install_command([extra], '--force-reinstall')}"
                    + (f", {WAY_OUT[extra]}" if extra in WAY_OUT else "")
                )
                break  # what depends on it fails, too
            missing.setdefault(extra, []).append(name)
    if missing:
        advice = "; ".join(WAY_OUT[extra] for extra in missing if extra in WAY_OUT)
        names = [name for of_extra in missing.values() for name in of_extra]
        gone = MissingExtraError(names, [*missing], advice)
        if not broken:
            raise gone
        broken += gone.problems
    if broken:
        raise InputError(broken)


def optional(module: str, purpose: str) -> Any:
    """Import a module that belongs to no extra, and that few people need.

    Args:
        module: name of the module, which pip calls the same.
        purpose: subject of the message.

    Raises:
        InputError: it is not installed, or cannot be imported.
    """
    problem = _problem(module, installed_only=False)
    if problem is None:
        return importlib.import_module(module)
    if problem:
        raise InputError(f"{purpose} needs {module}, which cannot be imported ({problem})")
    raise InputError(f"{purpose} needs {module}: python -m pip install {module}")


def _problem(module: str, *, installed_only: bool) -> str | None:
    """Return the error of a module that fails on import; empty: it is missing; None: it works."""
    try:
        if installed_only:
            return "" if importlib.util.find_spec(module) is None else None
        importlib.import_module(module)
    except Exception as error:  # an installed package may fail in any way
        gone = (error.name or module) if isinstance(error, ModuleNotFoundError) else "."
        if gone.partition(".")[0] == module.partition(".")[0]:
            return ""
        return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
    return None
