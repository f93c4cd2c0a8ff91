"""Reconstructions beside a run's own: a folder each, with settings, figures and cross-sections."""

from __future__ import annotations

import dataclasses
import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twinct.errors import InputError
from twinct.evaluate import ImageFigures
from twinct.files.plain_json import read_json
from twinct.files.writing import write_json
from twinct.report import CrossSection, plain, with_found
from twinct.volume import Volume

FORMAT = "twinct reconstruction 1"
_FILES = ("volume.nii", "sections.npz")
"""Of which a digest is kept; see ``check_files``."""
_ARRAYS = ("reconstruction", "truth", "roi")


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A reconstruction that is kept beside a run's own.

    Attributes:
        name: of its folder.
        digest: of everything that its voxels depend on.
        geometry: name of the geometry that it was made from.
        geometry_digest: of that geometry; empty for the scan's own.
        in_words: algorithm and settings in one line.
        settings: the section ``reconstruction`` that made it, defaults included.
        figures: against the truth.
        residuals: of each iteration.
        seconds: that it took.
        slices: cross-sections, see ``twinct.report.cross_sections``.
        path: its folder; the voxels are in ``volume.nii`` there.
        found: what its algorithm found out beside the voxels, see ``twinct.report.FOUND``.
    """

    name: str
    digest: str
    geometry: str
    geometry_digest: str
    in_words: str
    settings: Mapping[str, Any]
    figures: ImageFigures
    residuals: tuple[float, ...]
    seconds: float
    slices: Mapping[str, CrossSection]
    path: Path
    found: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def told(self) -> str:
        """How it was made, and what was found, in one line."""
        return with_found(self.in_words, self.found)

    @property
    def volume(self) -> Volume:
        """Its voxels, 1/mm."""
        return Volume.read(self.path / "volume.nii")

    def keep(self, volume: Volume) -> None:
        """Write it; its folder appears when it is complete.

        Raises:
            OSError: it cannot be written.
        """
        draft = self.path.with_name(f".{self.path.name}.partial")
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir(parents=True)
        volume.write(draft / "volume.nii", f"twinct {self.digest[:32]}")
        arrays = {
            f"{plane}.{name}": getattr(section, name)
            for plane, section in self.slices.items()
            for name in _ARRAYS
        }
        np.savez_compressed(draft / "sections.npz", **arrays)
        kept = {"format": FORMAT, **_plain(self)}
        kept["slices"] = {
            plane: (section.extent_mm, section.axes, section.position)
            for plane, section in self.slices.items()
        }
        kept["files"] = {name: _digest(draft / name) for name in _FILES}
        write_json(draft / "reconstruction.json", kept)
        draft.rename(self.path)

    def write_figures(self, figures: ImageFigures) -> None:
        """Write others in place of its figures."""
        file = self.path / "reconstruction.json"
        told = read_json(file)
        write_json(file, told | {"figures": plain(figures.as_dict())})

    @classmethod
    def read(cls, path: Path) -> Reconstruction:
        """Read what ``keep`` wrote, the voxels left aside.

        Raises:
            InputError: it is no such folder, or damaged.
        """
        try:
            told = read_json(path / "reconstruction.json")
            if told.pop("format") != FORMAT:
                raise ValueError(f"not of the format {FORMAT!r}")
            told.pop("files", None)
            # Two of its values once lay beside what is found now.
            before = {key: told.pop(key) for key in ("implants", "passes") if key in told}
            told.setdefault("found", {key: value for key, value in before.items() if value})
            with np.load(path / "sections.npz") as arrays:
                slices = {
                    plane: CrossSection(
                        *(arrays[f"{plane}.{name}"] for name in _ARRAYS),
                        extent_mm=tuple(extent),
                        axes=tuple(axes),
                        position=position,
                    )
                    for plane, (extent, axes, position) in told.pop("slices").items()
                }
            figures = {
                key: np.nan if value is None else value
                for key, value in told.pop("figures").items()
            }
            residuals = tuple(told.pop("residuals"))
            return cls(
                **told,
                figures=ImageFigures.of(figures),
                residuals=residuals,
                slices=slices,
                path=path,
            )
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise InputError(f"{path}: no reconstruction of a run: {error}") from None


def check_files(path: Path) -> None:
    """Compare a kept reconstruction with its digests.

    Raises:
        InputError: it cannot be read, or a file is not the one that was written.
    """
    found = Reconstruction.read(path)
    told = read_json(path / "reconstruction.json")
    for name, digest in told.get("files", {}).items():
        if not (path / name).is_file() or _digest(path / name) != digest:
            raise InputError(f"{path / name} is not the file of {found.name} that was written")


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def kept_reconstructions(folder: Path) -> dict[str, Reconstruction]:
    """All in a folder, by name; none where there is no folder.

    Raises:
        InputError: one is damaged.
    """
    if not folder.is_dir():
        return {}
    paths = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    return {path.name: Reconstruction.read(path) for path in paths}


def _plain(kept: Reconstruction) -> dict[str, Any]:
    told = {
        name: getattr(kept, name)
        for name in (one.name for one in dataclasses.fields(kept))
        if name not in ("slices", "path", "figures")
    }
    return told | {
        "residuals": list(kept.residuals),
        "settings": dict(kept.settings),
        "found": plain(kept.found),
        "figures": plain(kept.figures.as_dict()),
    }
