"""Further reconstructions of a run: a folder each, with settings, figures and cross-sections."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.arrays import read_npz
from twinct.core.files.boundary import no_file
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import complete, write_json
from twinct.evaluation import ImageFigures
from twinct.recon.volume import Volume
from twinct.report import CrossSection, plain, with_results
from twinct.scan import checked_name
from twinct.scenario import Scenario

FORMAT = "twinct reconstruction 1"
JUDGEMENT = "judgement.json"
"""File of a measured scan's volume, in place of the reconstruction's own."""
_FILES = ("volume.nii", "sections.npz")
"""Files whose digests are stored; see ``check_files``."""
_ARRAYS = ("reconstruction", "truth", "roi")
MOST_SECTION_BYTES = 2**30
"""Largest size of cross-sections: nine of 4,000 x 4,000 voxels have half of it."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A further reconstruction of a run, stored beside the run's own volume.

    Attributes:
        name: name of its folder.
        digest: digest of everything that its voxels depend on.
        geometry: name of the geometry that it was made from.
        geometry_digest: digest of the geometry; empty for the scan's own.
        in_words: algorithm and settings in one line.
        settings: the section ``reconstruction`` that made it, defaults included.
        figures: image figures, relative to the truth.
        residuals: residual of each iteration.
        seconds: duration of the reconstruction.
        slices: cross-sections, see ``twinct.report.cross_sections``.
        path: its folder; the voxels are in ``volume.nii`` there.
        results: further results of the algorithm, see ``twinct.report.ALGORITHM_RESULTS``.
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
    results: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def description(self) -> str:
        """Algorithm, settings and further results in one line."""
        return with_results(self.in_words, self.results)

    @property
    def volume(self) -> Volume:
        """The volume, 1/mm, read from its file."""
        return Volume.read(self.path / "volume.nii")

    def keep(self, volume: Volume) -> None:
        """Write the reconstruction; its folder appears only when it is complete.

        Raises:
            OSError: a file cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with complete(self.path) as draft:
            draft.mkdir()
            volume.write(draft / "volume.nii", f"twinct {self.digest[:32]}")
            arrays = {
                f"{plane}.{name}": getattr(section, name)
                for plane, section in self.slices.items()
                for name in _ARRAYS
            }
            np.savez_compressed(draft / "sections.npz", **arrays)
            data = {"format": FORMAT, **_plain(self)}
            data["slices"] = {
                plane: (section.extent_mm, section.axes, section.position)
                for plane, section in self.slices.items()
            }
            data["files"] = {name: file_digest(draft / name) for name in _FILES}
            write_json(draft / "reconstruction.json", data)

    def write_figures(self, figures: ImageFigures) -> None:
        """Replace the figures in the folder."""
        file = self.path / "reconstruction.json"
        data = read_json(file)
        write_json(file, data | {"figures": plain(figures.as_dict())})

    @classmethod
    def read(cls, path: Path) -> Reconstruction:
        """Read a folder that ``keep`` wrote, without the voxels.

        Raises:
            InputError: the folder holds no reconstruction, or is damaged.
        """
        try:
            data = read_json(path / "reconstruction.json")
            if data.pop("format") != FORMAT:
                raise ValueError(f"not of the format {FORMAT!r}")
            data.pop("files", None)
            # Earlier versions stored these two keys at the top level instead of in ``found``.
            before = {key: data.pop(key) for key in ("implants", "passes") if key in data}
            results = data.pop("found", {key: value for key, value in before.items() if value})
            if why := no_file(path / "sections.npz"):
                raise ValueError(f"sections.npz {why}")
            arrays = read_npz(path / "sections.npz", "sections.npz", MOST_SECTION_BYTES)
            slices = {
                plane: CrossSection(
                    *(arrays[f"{plane}.{name}"] for name in _ARRAYS),
                    extent_mm=tuple(extent),
                    axes=tuple(axes),
                    position=position,
                )
                for plane, (extent, axes, position) in data.pop("slices").items()
            }
            figures = {
                key: np.nan if value is None else value
                for key, value in data.pop("figures").items()
            }
            residuals = tuple(data.pop("residuals"))
            return cls(
                **data,
                results=results,
                figures=ImageFigures.of(figures),
                residuals=residuals,
                slices=slices,
                path=path,
            )
        except (OSError, ValueError, TypeError, KeyError, InputError) as error:
            raise InputError(f"{path} is not a reconstruction of a run: {error}") from None


def check_files(path: Path) -> None:
    """Check the files of a reconstruction against their digests.

    Raises:
        InputError: the folder cannot be read, or a file differs from its digest.
    """
    if (path / JUDGEMENT).is_file():
        data = read_json(path / JUDGEMENT)
    else:
        Reconstruction.read(path)
        data = read_json(path / "reconstruction.json")
    for name, digest in data.get("files", {}).items():
        if not (path / name).is_file() or file_digest(path / name) != digest:
            raise InputError(f"{path / name} differs from the file written for {path.name}")


def free_name(requested: str | None, base: str, folder: Path, what: str = "reconstruction") -> str:
    """Return the name of a new result in a folder: as requested, or the base, numbered if taken.

    Raises:
        InputError: the name is no name of a file.
        ScanExistsError: the requested name is taken.
    """
    if requested is not None:
        if (there := folder / checked_name(requested)).exists():
            raise ScanExistsError(f"{there} is another {what}; choose another --as")
        return requested
    names = itertools.chain([base], (f"{base}-{number}" for number in itertools.count(2)))
    return next(name for name in names if not (folder / name).exists())


def reconstruction_base(scenario: Scenario, which: str) -> str:
    """Return the name of a reconstruction after its algorithm and geometry."""
    algorithm = scenario.reconstruction.algorithm
    return algorithm if which == "believed" else f"{algorithm}-{which}"


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def stored_reconstructions(folder: Path) -> dict[str, Reconstruction]:
    """Read all reconstructions in a folder, by name; an absent folder has none.

    Raises:
        InputError: a reconstruction is damaged.
    """
    if not folder.is_dir():
        return {}
    paths = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    return {path.name: Reconstruction.read(path) for path in paths}


def _plain(reconstruction: Reconstruction) -> dict[str, Any]:
    data = {
        name: getattr(reconstruction, name)
        for name in (one.name for one in dataclasses.fields(reconstruction))
        if name not in ("slices", "path", "figures", "results")
    }
    return data | {
        "residuals": list(reconstruction.residuals),
        "settings": dict(reconstruction.settings),
        "found": plain(reconstruction.results),
        "figures": plain(reconstruction.figures.as_dict()),
    }
