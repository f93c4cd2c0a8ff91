"""Scenarios that come with twinct, by name: the files of ``scenarios/`` in the repository.

In the repository, ``built_in`` is a link to that folder; the wheel holds its files instead.
"""

from __future__ import annotations

import difflib
from functools import cache
from pathlib import Path

from twinct.core.errors import ScenarioError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.foreign_text import quoted, shortened

FOLDER = Path(__file__).parent / "built_in"
_SUFFIX = ".yaml"


@cache
def scenario_names() -> tuple[str, ...]:
    """Return the names of the scenarios that come with twinct, in alphabetical order."""
    return tuple(sorted(file.stem for file in FOLDER.glob(f"*{_SUFFIX}")))


def scenario_file(path: Path, folder: Path = Path(), at: str = "") -> Path:
    """Return the file of a scenario that is stated as a path, or by the name of a built-in one.

    A file at the path takes precedence, but a folder of this name does not. Names have no folder
    and no suffix. Whoever reads the file reports that it is missing.

    Args:
        path: the path, relative to ``folder``, or the name.
        folder: folder of the file that states it.
        at: beginning of the message.

    Raises:
        ScenarioError: a name that no built-in scenario has; the message lists them.
    """
    name, file = str(path), folder / path
    known = name in scenario_names()
    if no_file(file) != ABSENT and not (known and file.is_dir()):
        return file
    if known:
        return FOLDER / f"{name}{_SUFFIX}"
    if path.name != name or path.suffix:
        return file
    near = difflib.get_close_matches(name, scenario_names(), n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise ScenarioError(
        f"{at}{quoted(shortened(name, 300))} is neither a scenario file nor a built-in scenario"
        f"{hint} (built in: {', '.join(scenario_names())})"
    )


def same_name(path: Path) -> str:
    """Return a hint if the name of a missing file is that of a built-in scenario, else nothing."""
    known = path.suffix == _SUFFIX and path.stem in scenario_names()
    return f"; the built-in scenario is called {path.stem}, without a folder" if known else ""
