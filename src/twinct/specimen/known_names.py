"""Names of parts and labels, checked before any voxel is read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from twinct.core.errors import InputError, SpecimenError
from twinct.core.files.nifti import open_nifti
from twinct.core.foreign_text import quoted
from twinct.core.settings import Conflict
from twinct.specimen import sections
from twinct.specimen.phantom import phantom
from twinct.specimen.sections.specimen import OpenNames
from twinct.specimen.voxel_labels import header_names, mask_files

NUMBERED = re.compile(r"label_[1-9]\d*")
"""Names of labels that neither the scenario nor their file names."""


class KnownNames(list[str]):
    """Names of parts and of labels that may have a voxel.

    Attributes:
        numbered: True if labels may also be called label_1, label_2, ...
    """

    numbered = False

    @property
    def in_words(self) -> str:
        """All names, for messages."""
        return quoted(self, 300) + (" and label_1, label_2, ..." if self.numbered else "")

    def __contains__(self, name: object) -> bool:
        """Return True if a part or a label may have a name."""
        return super().__contains__(name) or bool(
            self.numbered and isinstance(name, str) and NUMBERED.fullmatch(name)
        )


def require_known_names(
    section: sections.Specimen,
    named: Iterable[tuple[str, str]],
    conflicts: Callable[[Sequence[str]], Iterable[Conflict]],
) -> None:
    """Check the names of parts and labels that a scenario states anywhere.

    Args:
        section: the specimen.
        named: further keys that name a part or a label, each with the name.
        conflicts: finds names that are not among those of the specimen.

    Raises:
        InputError: no part and no label has the name; or a file of labels is damaged.
    """
    if not isinstance(section.names, OpenNames):  # else checked with the scenario
        return
    reference = [("specimen.reference", section.reference)] if section.reference else []
    known = known_names(section)
    problems = [
        f"{key}: no part or label is called {quoted(name)}; there are {known.in_words}"
        for key, name in (*reference, *named)
        if name not in known
    ]
    problems += [one.message for one in conflicts(known)]
    if problems:
        raise InputError(problems)


def known_names(section: sections.Specimen) -> KnownNames:
    """Return the names of a specimen's parts and labels, from keys, headers and phantoms.

    Raises:
        SpecimenError: a file of labels is damaged; names the part.
    """
    names_so_far = KnownNames()
    for part in section.parts:
        names_so_far.append(part.label)
        shape = part.shape
        if not isinstance(shape, sections.GreyVolume):
            continue
        if shape.phantom:
            names_so_far += phantom(shape.phantom, shape.seed).names[1:]
        elif shape.labels:
            names = _of_files(shape.labels, f"part {part.label!r}: labels {shape.labels.path}")
            names_so_far += names
            names_so_far.numbered |= names.numbered
    return names_so_far


def _of_files(section: sections.Labels, where: str) -> KnownNames:
    if section.names:
        return KnownNames(section.names)
    path: Path = section.path
    if path.is_dir():
        return KnownNames(mask_files(path))
    open_nifti(path, where, SpecimenError)
    result = KnownNames(header_names(path).values())
    result.numbered = True
    return result
