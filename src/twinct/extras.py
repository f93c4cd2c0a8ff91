"""Packages of each extra, and one check, before any work, that they are installed."""

from __future__ import annotations

import importlib
import importlib.util

from twinct.errors import InputError, MissingExtraError

_IMPORTED: dict[str, tuple[str, ...]] = {
    "robots": ("mujoco", "mink", "daqp", "ruckig", "ompl"),
    "rtk": ("itk",),
    "record": ("mcap.writer", "mcap_ros2.writer"),
    "study": ("pandas", "pyarrow.parquet"),
    "ros": (
        *("rclpy", "rclpy.node", "geometry_msgs.msg", "sensor_msgs.msg", "std_msgs.msg"),
        *("trajectory_msgs.msg", "std_srvs.srv"),
        *("diagnostic_msgs.msg", "rosgraph_msgs.msg", "builtin_interfaces.msg"),
    ),
}
"""Modules that are cheap to import. They are imported, since an installed module may be broken."""

_FOUND: dict[str, tuple[str, ...]] = {
    "xray": ("gvxrPython3",),
    "study": ("optuna",),
    "planning": ("cmaes",),
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
    "mcap_ros2": "mcap-ros2-support",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "fast_simplification": "fast-simplification",
}
"""Names of modules in pip, where they differ."""

_WAY_OUT = {"ros": "or use --link local", "rtk": "or use reconstruction.algorithm: sart"}


def require(*extras: str) -> None:
    """Make sure that extras are installed and can be imported.

    Args:
        extras: names of extras in ``pyproject.toml``.

    Raises:
        MissingExtraError: one package is missing; the message names the extra and an alternative.
        InputError: several packages are missing, or one is installed and cannot be imported.
    """
    missing = [error for extra in extras if (error := _missing(extra)) is not None]
    if len(missing) == 1:
        raise missing[0]
    if missing:
        raise InputError([problem for error in missing for problem in error.problems])


def _missing(extra: str) -> InputError | None:
    advice, found_only = _WAY_OUT.get(extra, ""), _FOUND.get(extra, ())
    for module in (*found_only, *_IMPORTED.get(extra, ())):
        package = module.partition(".")[0]
        name = _CALLED.get(package, package)
        try:
            if module not in found_only:
                importlib.import_module(module)
            elif importlib.util.find_spec(module) is None:
                return MissingExtraError(name, extra, advice)
        except Exception as error:  # an installed package may fail in any way
            gone = (error.name or package) if isinstance(error, ModuleNotFoundError) else ""
            if gone.partition(".")[0] == package:
                return MissingExtraError(name, extra, advice)
            tail = f", {advice}" if advice else ""
            return InputError(
                f"{name} is installed but cannot be imported ({type(error).__name__}: {error}): "
                "install it again with 'pip install --force-reinstall "
                f".[{extra}]' in the folder of twinct's sources{tail}"
            )
    return None
