"""Section of the reconstruction: the keys that all algorithms share, and the keys of each one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Union, cast

import numpy as np
from pydantic import Discriminator, Field, Tag, create_model, model_validator

from twinct.core.foreign_text import counted
from twinct.core.settings import Length, Lengths, OneOf, Section, Vector, complete, facts, setting
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.recon.algorithm import Algorithm
from twinct.recon.algorithms import algorithms
from twinct.recon.sections.beam_hardening import BeamHardening
from twinct.recon.sections.known_motion import KnownMotion
from twinct.recon.sections.metal import Metal
from twinct.recon.sections.scatter import ScatterCorrection

DEFAULT_ALGORITHM = "sart"


MOST = 65_536
"""Largest number of voxels along an axis; the memory may allow fewer."""


class Grid(Section):
    """Voxels of the reconstruction."""

    voxels: Annotated[int, Field(ge=2, le=4096)] | tuple[int, int, int] = setting(
        512, "Voxels along each axis; three numbers for (x, y, z).", source="the paper"
    )
    voxel_mm: Length | Lengths = setting(
        0.31, "Voxel edge; three numbers for (x, y, z).", source="the paper"
    )
    centre_mm: Vector = setting((0.0, 0.0, 0.0), "Centre of the grid in the world.")
    rotation_deg: Vector = setting((0.0, 0.0, 0.0), "Extrinsic rotations about x, y, z.")

    @model_validator(mode="after")
    def _some_voxels(self) -> Grid:
        if isinstance(self.voxels, tuple) and not all(2 <= n <= MOST for n in self.voxels):
            raise ValueError(f"voxels {self.voxels} must be 2 to {MOST} along each axis")
        return self

    @property
    def volume_grid(self) -> VolumeGrid:
        """Voxel lattice."""
        nx, ny, nz = self.voxels if isinstance(self.voxels, tuple) else (self.voxels,) * 3
        return VolumeGrid(
            (nz, ny, nx), self.voxel_mm, Pose.from_euler(self.centre_mm, self.rotation_deg)
        )


GeometryName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
"""``commanded``, ``executed``, ``believed``, or the name of a geometry derived from the scan."""


class Surroundings(Section):
    """Coarse reconstruction of more than the grid, used to remove the surroundings of the grid."""

    margin_mm: Length = Field(
        description="Margin by which the coarse grid exceeds the grid on each side; the "
        "specimen should lie inside the coarse grid.",
        json_schema_extra=facts(source="Ziegler, Nielsen and Grass, Med. Phys. 35 (2008)"),
    )
    voxel_mm: Length = Field(description="Coarse voxel edge, such as four times the grid's.")
    iterations: int = setting(20, "Iterations of the coarse SART.", ge=1, le=10_000)
    relaxation: float = setting(1.0, "Relaxation of the coarse SART.", gt=0, lt=2)


class Zoom(Section):
    """Region with finer voxels, reconstructed in place of the grid, along the grid's axes."""

    centre_mm: Vector = setting((0.0, 0.0, 0.0), "Centre of the region in the world.")
    size_mm: Length | Lengths = Field(
        description="Edges of the region; three numbers for (x, y, z)."
    )
    voxel_mm: Length = Field(description="Voxel edge; adjusted slightly to fit the region.")
    iterations: int = setting(
        5,
        "Iterations of a SART on the whole grid, which yields the surroundings of the region that "
        "are removed.",
        ge=1,
        le=10_000,
    )
    relaxation: float = setting(0.3, "Relaxation of that SART.", gt=0, lt=2)


class Around(NamedTuple):
    """Arguments of ``without_surroundings``, which runs before a volume is made."""

    margin_mm: float | tuple[tuple[float, ...], ...]
    voxel_mm: float
    iterations: int
    relaxation: float


class Reconstruction(Section):
    """Reconstruction from projections: keys that all algorithms share. Each adds its own keys."""

    algorithm: str = setting(
        DEFAULT_ALGORITHM,
        "Name of the algorithm; docs/reconstruction.md says which one suits which purpose.",
        source="the paper",
    )
    surroundings: Surroundings | None = setting(None, "Remove the surroundings of the grid first.")
    scatter: ScatterCorrection | None = setting(
        None, "Subtraction of scatter from the images, before all other corrections."
    )
    beam_hardening: BeamHardening | None = setting(
        None, "Correction of line integrals before reconstruction."
    )
    metal: Metal | None = setting(None, "Treatment of rays through metal.")
    motion: KnownMotion | None = setting(
        None, "Known motion of the patient (specimen.motion); null: it is ignored."
    )
    geometry: GeometryName | tuple[GeometryName, ...] = setting(
        "believed",
        "Geometry to reconstruct from: commanded, executed, believed, or the name of a geometry "
        "derived from the scan (twinct geometry). Several are evaluated side by side, and the "
        "volume of the first one is kept.",
        source="the paper",
    )
    grid: Grid = setting(Grid(), "Voxel grid.")
    zoom: Zoom | None = setting(
        None,
        "Reconstruct only a part of the grid, in finer voxels; the rest of the grid is removed.",
    )

    @model_validator(mode="after")
    def _distinct_geometries(self) -> Reconstruction:
        if not self.geometries or len(set(self.geometries)) != len(self.geometries):
            raise ValueError("geometry must name at least one geometry, and none twice")
        return self

    @model_validator(mode="after")
    def _zoom_in_grid(self) -> Reconstruction:
        if self.zoom is not None and (beyond := -np.min(self._sides())) > 1e-6:
            raise ValueError(
                f"zoom reaches {beyond:.1f} mm beyond the grid; it must lie inside the grid"
            )
        return self

    @property
    def volume_grid(self) -> VolumeGrid:
        """Voxels of the reconstructed volume: the grid's, or the zoom's."""
        whole = self.grid.volume_grid
        if self.zoom is None:
            return whole
        size = np.broadcast_to(np.asarray(self.zoom.size_mm, dtype=np.float64), (3,))
        across = np.maximum(np.round(size / self.zoom.voxel_mm), 2).astype(int)
        place = Pose.from_euler(self.zoom.centre_mm, self.grid.rotation_deg)
        return VolumeGrid(across[::-1].tolist(), size / across, place)

    @property
    def around(self) -> Around | None:
        """Surroundings to remove first. With a zoom, too, they begin where the whole grid ends."""
        zoom, wide = self.zoom, self.surroundings
        if zoom is None:
            return None if wide is None else Around(**dict(wide))
        margins = np.maximum(self._sides(), 0) + (wide.margin_mm if wide else 0.0)
        if not margins.any():
            return None
        edge = float(self.grid.volume_grid.voxel.min())
        sides = tuple(tuple(side.tolist()) for side in margins)
        return Around(sides, edge, zoom.iterations, zoom.relaxation)

    def _sides(self) -> Floats:
        """Return how far the whole grid reaches beyond the zoom, (2, 3): below and above, mm."""
        whole, part = self.grid.volume_grid, self.volume_grid
        middle = whole.world_from_grid.inverse().apply(part.world_from_grid.position)
        spare = (whole.size_mm - part.size_mm) / 2
        return np.stack([spare + middle, spare - middle])

    @property
    def geometries(self) -> tuple[GeometryName, ...]:
        """Names of the geometries, always as a tuple."""
        return self.geometry if isinstance(self.geometry, tuple) else (self.geometry,)

    @property
    def in_words(self) -> str:
        """Algorithm, its own keys and the corrections, in one line."""
        words = [self.algorithm]
        words += [_in_words(key, getattr(self, key)) for key in own_keys(type(self))]
        if self.scatter:
            words.append(f"scatter subtracted in {counted(self.scatter.rounds, 'round')}")
        if self.beam_hardening:
            words.append(f"beam hardening of {self.beam_hardening.kind.replace('_', ' ')}")
        if self.motion:
            words.append(_motion_in_words(self.motion))
        if self.surroundings:
            words.append(f"surroundings of {self.surroundings.margin_mm:g} mm removed")
        if self.zoom:
            voxel = self.volume_grid.voxel.min()
            words.append(f"zoom with voxels of {voxel:.3g} mm")
        if self.metal:
            words.append(
                "metal replaced (nmar)"
                if self.metal.method == "nmar"
                else f"{len(self.metal.implants)} known implants removed"
            )
        return ", ".join(filter(None, words))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the values alone, since every process creates the class anew."""
        return _restored, (self.model_dump(),)


def _in_words(key: str, value: Any) -> str:
    if value is None or value is False:
        return ""
    if key == "iterations":
        return counted(value, "iteration")
    name = key.replace("_", " ")
    if value is True:
        return name
    if isinstance(value, Path):
        return f"{name} {value.name}"
    return f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"


def _motion_in_words(section: KnownMotion) -> str:
    words = "motion compensated" if section.compensate else "motion ignored"
    if section.compensate and section.amplitude_rel != 1:
        words += f" with {section.amplitude_rel:g} of its amplitude"
    if section.compensate and section.delay_s:
        words += f" {section.delay_s:g} s late"
    if section.gate is not None:
        words += " in phases {:g} to {:g}".format(*section.gate)
    return f"{words} at phase {section.phase:g}" if section.phase else words


def own_keys(section: type[Section]) -> list[str]:
    """Return the keys that a section has because of its algorithm."""
    return [key for key in section.model_fields if key not in Reconstruction.model_fields]


def _with_settings(algorithm: Algorithm[Any]) -> type[Reconstruction]:
    settings = algorithm.settings
    common = set(settings.model_fields) & set(Reconstruction.model_fields) - {"algorithm"}
    if common:
        raise ValueError(
            f"they redefine keys that every algorithm has: {', '.join(sorted(common))}"
        )
    name: Any = settings.model_fields["algorithm"].annotation
    section: Any = create_model(
        f"{settings.__name__}Reconstruction",
        __base__=(Reconstruction, settings),
        __doc__=settings.__doc__,
        algorithm=(name, setting(algorithm.name, "Name of the algorithm.")),
    )
    return section


@cache
def _made() -> Mapping[str, type[Reconstruction]]:
    """Return the section of each algorithm; they are made once per process, at their first use."""
    made: dict[str, type[Reconstruction]] = {}

    def make(algorithm: Algorithm[Any]) -> None:
        made[algorithm.name] = _with_settings(algorithm)
        complete(made[algorithm.name])

    algorithms().keep(make, "the settings of {name}")
    return made


class _Sections(Mapping[str, type[Reconstruction]]):
    """Mapping whose classes are made at its first use."""

    def __getitem__(self, name: str) -> type[Reconstruction]:
        return _made()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(_made())

    def __len__(self) -> int:
        return len(_made())


SECTIONS: Mapping[str, type[Reconstruction]] = _Sections()
"""Section of each algorithm, by name."""


def default_reconstruction(**keys: Any) -> Reconstruction:
    """Return the reconstruction of a scenario that states only these keys."""
    return SECTIONS[DEFAULT_ALGORITHM].model_validate(keys)


def _named(value: Any) -> str:
    """Return the algorithm that a section, or its plain data, names."""
    if isinstance(value, dict):
        return str(cast("dict[str, Any]", value).get("algorithm", DEFAULT_ALGORITHM))
    return str(getattr(value, "algorithm", DEFAULT_ALGORITHM))


def _restored(data: dict[str, Any]) -> Reconstruction:
    return SECTIONS[_named(data)].model_validate(data)


def _any_section() -> Any:
    return Annotated[
        Union[tuple(Annotated[section, Tag(name)] for name, section in SECTIONS.items())],  # noqa: UP007
        Discriminator(_named),
    ]


AnyReconstruction = Annotated[Reconstruction, OneOf(_any_section)]
