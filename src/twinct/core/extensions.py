"""Extensions by other distributions: loaded from their entry points, alike in every process."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted

log = logging.getLogger(__name__)

T = TypeVar("T")


class Registry(dict[str, T]):
    """Choices of one kind of extension by name, the built-in ones first.

    Entry points that cannot be loaded, lead to another type, do not fit, or use a name that is
    taken are logged and left out: they must not stop those who do not use them.

    Attributes:
        built_in: the choices of this package.
        broken: names that cannot be chosen, each with its distribution and the reason.
    """

    def __init__(
        self, group: str, kind: type[T], built_in: Mapping[str, T], taken: Collection[str] = ()
    ) -> None:
        """Find the choices that this package and all other distributions offer.

        Args:
            group: group of the entry points; each has the name of its object.
            kind: type of the objects; their ``name`` is the name in a scenario.
            built_in: choices of this package, by name; no other distribution may take these names.
            taken: further names that no distribution may take.
        """
        super().__init__(built_in)
        self.built_in = dict(built_in)
        self.broken: dict[str, str] = {}
        points, reserved = entry_points(group=group), {*built_in, *taken}
        for point in points:
            try:
                rivals = {_owner(other) for other in points.select(name=point.name)}
                if point.name in reserved:
                    raise ValueError("this name is built into twinct")
                if len(rivals) > 1:
                    packages = ", ".join(sorted(rivals))
                    raise ValueError(f"several packages offer this name: {packages}")
                loaded = point.load()
                if not isinstance(loaded, kind):
                    raise TypeError(f"it points to {type(loaded).__name__}, not to {kind.__name__}")
                if (own := getattr(loaded, "name", None)) != point.name:
                    raise ValueError(f"its own name is {own!r}")
                self[point.name] = loaded
            except Exception as error:  # an external module may fail in any way
                cannot = f"{point.name!r} of {_owner(point)} cannot be used"
                reason = f"{cannot}: {type(error).__name__}: {error}"
                log.warning("%s: %s", group, reason)
                if point.name not in reserved:
                    self.broken[point.name] = reason

    def keep(self, fits: Callable[[T], object], what: str) -> None:
        """Leave out the choices that do not fit.

        Args:
            fits: raises an error of any kind for such a choice.
            what: subject of the message, which {name} completes.
        """
        for name, choice in list(self.items()):
            try:
                fits(choice)
            except Exception as error:  # settings may come from any package
                del self[name]
                self.broken[name] = f"{what.format(name=quoted(name))} cannot be used: {error}"
                log.warning(self.broken[name])

    def named(self, name: str, origin: str) -> T:
        """Return the choice of a name; messages start with ``origin``, such as an option.

        Raises:
            InputError: there is no such choice, or the package that offers it is broken.
        """
        if name not in self:
            unknown = f"unknown; choose from {', '.join(self)}"
            raise InputError(f"{origin} {name}: {self.broken.get(name, unknown)}")
        return self[name]


def _owner(point: EntryPoint) -> str:
    dist = point.dist
    return f"{dist.name} {dist.version}" if dist else point.value
