"""Modules that have another name now: the old one still imports, with a warning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

RENAMED = {"twinct.evaluate": "twinct.evaluation"}
"""New names of packages and modules, by their old ones."""


class _Alias(Loader):
    """Import a module by its new name."""

    def __init__(self, new: str) -> None:
        self.new = new

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module itself, so that its classes stay the same ones."""
        module = import_module(self.new)
        self._own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give back what the import system has set."""
        module.__spec__ = self._own


class _OldNames(MetaPathFinder):
    """Find renamed modules, before other finders load their files a second time."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of the renamed module; None if the name is not an old one."""
        for old, new in RENAMED.items():
            if fullname == old or fullname.startswith(old + "."):
                new += fullname[len(old) :]
                warnings.warn(f"{fullname} is now {new}", DeprecationWarning, stacklevel=2)
                return ModuleSpec(fullname, _Alias(new), is_package=True)
        return None


class Package(ModuleType):
    """The package ``twinct``, in which a function may have the name of a renamed module."""

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute, but no renamed module, which the import system would set."""
        if not (isinstance(value, ModuleType) and f"{self.__name__}.{name}" in RENAMED):
            super().__setattr__(name, value)


def install(package: str) -> None:
    """Let the old names import from now on."""
    sys.meta_path.insert(0, _OldNames())
    sys.modules[package].__class__ = Package
