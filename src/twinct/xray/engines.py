"""All X-ray engines by name, built in or from extensions."""

from __future__ import annotations

import difflib
from functools import cache
from importlib.util import find_spec

from twinct.core.errors import InputError
from twinct.core.extensions import Registry
from twinct.core.foreign_text import quoted
from twinct.xray.cuda_mesh import CUDA_MESH
from twinct.xray.engine import EngineChoice
from twinct.xray.gvxr import GVXR
from twinct.xray.mesh import MESH

DEFAULT_ENGINE = GVXR.name
BUILT_IN = {choice.name: choice for choice in (GVXR, MESH, CUDA_MESH)}


@cache
def engines() -> Registry[EngineChoice]:
    """Return the engines that a scenario can name; they are looked up once per process."""
    return Registry("twinct.xray_engines", EngineChoice, BUILT_IN)


def engine_named(name: str) -> EngineChoice:
    """Return the engine of a name. Those of other packages are loaded only if one is named.

    Raises:
        InputError: the name is unknown, its entry point is broken, or a module of the engine is not
            installed.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    if name not in (known := engines()):
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        reason = known.broken.get(name, f"there is no engine {quoted(name)}{hint}")
        raise InputError(f"xray.engine: {reason} (allowed: {', '.join(known)})")
    choice = known[name]
    if missing := [module for module in choice.modules if not _installed(module)]:
        free = (one.name for one in BUILT_IN.values() if not one.modules)
        raise InputError(
            f"xray.engine: the engine {quoted(name)} needs {', '.join(missing)}, not "
            "installed here "
            f"(allowed without: {', '.join(free)})"
        )
    return choice


def engine_extras(name: str | None) -> tuple[str, ...]:
    """Return the extras that an engine needs; none without an engine.

    Raises:
        InputError: see ``engine_named``.
    """
    return engine_named(name).extras if name is not None else ()


def prepare_engine(name: str = DEFAULT_ENGINE) -> None:
    """Load an engine and check that it works, so that a later imager starts at once.

    Raises:
        InputError: the engine, or a package or system library that it needs, is not installed.
    """
    engine_named(name).engine.prepare()


def _installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # its parent is missing, or it is blocked
        return False
