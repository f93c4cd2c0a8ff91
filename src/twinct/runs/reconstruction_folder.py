"""Reconstructions of a scan: a folder each, with settings, figures and cross-sections."""

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
from twinct.report.earlier_names import with_todays_names
from twinct.runs.judgement import Judgement
from twinct.scan import Scan, checked_name
from twinct.scenario.imported import as_stated

FORMAT = "twinct reconstruction 1"
RECORD = "reconstruction.json"
_JUDGEMENT = "judgement.json"
"""File of a volume without a truth, as earlier versions wrote it."""
_OF_JUDGEMENT = "twinct measured volume 1"
_FILES = ("volume.nii", "sections.npz")
"""Files whose digests are stored; see ``check_files``."""
_ARRAYS = ("reconstruction", "truth", "roi")
MOST_SECTION_BYTES = 2**30
"""Largest size of cross-sections: nine of 4,000 x 4,000 voxels have half of it."""


@dataclass(frozen=True, eq=False)
class StoredReconstruction:
    """A reconstruction of a scan, stored beside the run's own volume, if it has one.

    Attributes:
        name: name of its folder.
        digest: digest of everything that its voxels depend on.
        geometry: name of the geometry that it was made from.
        geometry_digest: digest of the geometry; empty for the scan's own.
        in_words: algorithm and settings in one line.
        settings: the section ``reconstruction`` that made it, defaults included.
        figures: image figures relative to the truth or, without one, those that need none.
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
    figures: VolumeFigures
    residuals: tuple[float, ...]
    seconds: float
    slices: Mapping[str, CrossSection]
    path: Path
    results: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def description(self) -> str:
        """Algorithm, settings and further results in one line."""
        return with_results(self.in_words, self.results)

    def judged_in_words(self, material: str = "") -> str:
        """Return name, settings and main figures in one line.

        Args:
            material: name of the material to which figures beside a truth are relative.
        """
        time = f"{self.seconds:.1f} s, " if isinstance(self.figures, Judgement) else ""
        return (
            f"{self.name}: {self.description}, {self.geometry} geometry; "
            f"{time}{self.figures.in_words(material)}"
        )

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
                f"{plane}.{name}": array
                for plane, section in self.slices.items()
                for name in _ARRAYS
                if (array := getattr(section, name)) is not None
            }
            np.savez_compressed(draft / "sections.npz", **arrays)
            data = {"format": FORMAT, **_plain(self)}
            data["slices"] = {
                plane: (section.extent_mm, section.axes, section.position)
                for plane, section in self.slices.items()
            }
            data["files"] = {name: file_digest(draft / name) for name in _FILES}
            write_json(draft / RECORD, data)

    def with_figures(self, figures: VolumeFigures) -> StoredReconstruction:
        """Replace the figures, also in the folder, and return the reconstruction with them."""
        file = _record_of(self.path)
        key = "figures" if file.name == RECORD else "judgement"
        write_json(file, read_json(file) | {key: plain(figures.as_dict())})
        return dataclasses.replace(self, figures=figures)

    @classmethod
    def read(cls, path: Path) -> StoredReconstruction:
        """Read a folder that ``keep`` wrote, without the voxels.

        Raises:
            InputError: the folder holds no reconstruction, or is damaged.
        """
        try:
            data = read_json(_record_of(path))
            if data.get("format") == _OF_JUDGEMENT:
                data = _of_judgement(data)
            if data.pop("format") != FORMAT:
                raise ValueError(f"not of the format {FORMAT!r}")
            data.pop("files", None)
            # Earlier versions stored these two keys at the top level instead of in ``found``.
            before = {key: data.pop(key) for key in ("implants", "passes") if key in data}
            results = data.pop("found", {key: value for key, value in before.items() if value})
            slices = _sections(path, data.pop("slices"))
            figures = {
                key: np.nan if value is None else value
                for key, value in with_todays_names(data.pop("figures")).items()
            }
            of = Judgement if "residual_by_view" in figures else ImageFigures
            residuals = tuple(data.pop("residuals"))
            return cls(
                **data,
                slices=slices,
                results=results,
                figures=of.of(figures),
                residuals=residuals,
                path=path,
            )
        except (OSError, ValueError, TypeError, KeyError, InputError) as error:
            raise InputError(f"{path} is not a reconstruction of a run: {error}") from None


VolumeFigures = ImageFigures | Judgement


def _record_of(path: Path) -> Path:
    """Return the file of everything but voxels and cross-sections."""
    before = path / _JUDGEMENT
    return before if before.is_file() else path / RECORD


def _of_judgement(data: dict[str, Any]) -> dict[str, Any]:
    """Return what an earlier version wrote of a volume without a truth, in today's form."""
    kept = {key: data[key] for key in ("name", "in_words", "settings", "residuals", "seconds")}
    return {
        **kept,
        "format": FORMAT,
        "digest": "",
        "geometry": as_stated(data["geometry"]),
        "geometry_digest": "",
        "slices": {},
        "found": {},
        "figures": data["judgement"],
    }


def _sections(path: Path, places: Mapping[str, Any]) -> dict[str, CrossSection]:
    """Return the cross-sections of a folder, by name; an early volume without a truth has none."""
    if not places:
        return {}
    if why := no_file(path / "sections.npz"):
        raise ValueError(f"sections.npz {why}")
    arrays = read_npz(path / "sections.npz", "sections.npz", MOST_SECTION_BYTES)
    return {
        plane: CrossSection(
            arrays[f"{plane}.reconstruction"],
            arrays.get(f"{plane}.truth"),
            arrays[f"{plane}.roi"],
            extent_mm=tuple(extent),
            axes=tuple(axes),
            position=position,
        )
        for plane, (extent, axes, position) in places.items()
    }


def check_files(path: Path) -> None:
    """Check the files of a reconstruction against their digests.

    Raises:
        InputError: the folder cannot be read, or a file differs from its digest.
    """
    StoredReconstruction.read(path)
    data = read_json(_record_of(path))
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


def reconstruction_base(scan: Scan, which: str) -> str:
    """Return the name of a reconstruction after its algorithm and geometry."""
    algorithm = scan.settings.reconstruction.algorithm
    return algorithm if which == scan.reported.name else f"{algorithm}-{which}"


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def stored_reconstructions(folder: Path) -> dict[str, StoredReconstruction]:
    """Read all reconstructions in a folder, by name; an absent folder has none.

    Raises:
        InputError: a reconstruction is damaged.
    """
    if not folder.is_dir():
        return {}
    paths = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    return {path.name: StoredReconstruction.read(path) for path in paths}


def _plain(reconstruction: StoredReconstruction) -> dict[str, Any]:
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
