"""Volumes: voxels with their grid, shown in notebooks and stored as files of several formats."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError, ScanExistsError
from twinct.core.extras import optional
from twinct.core.files.nifti import read_nifti
from twinct.core.files.pictures import notebook_widgets, show
from twinct.core.files.writing import complete, storage_errors
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.recon.sections_picture import SIZE_INCH, draw_sections, show_with_sliders
from twinct.recon.volume_formats import (
    VolumeFacts,
    format_of_name,
    volume_format_named,
    volume_formats,
)

if TYPE_CHECKING:
    from twinct.recon.volume_formats import VolumeFacts

AIR_HU = -1000.0

SAME_MM = 1e-3
"""Two grids count as equal if no voxel centre differs by more: NIfTI stores a grid in float32."""


@dataclass(frozen=True, eq=False, repr=False)
class Volume(NDArrayOperatorsMixin):
    """Voxels and their grid, used like an array: shape, indices, arithmetic, numpy's functions.

    Arithmetic gives a volume on the same grid; comparisons and indices give arrays. Two volumes are
    equal (``==``) only if they are one object.

    Attributes:
        array: (z, y, x), float32, read-only.
        grid: the voxel lattice.
        extras: further results of the algorithm, by name.
    """

    array: NDArray[np.float32]
    grid: VolumeGrid
    extras: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def __post_init__(self) -> None:
        """Lock the array.

        Raises:
            InputError: the shapes of array and grid differ.
        """
        array = np.ascontiguousarray(self.array, dtype=np.float32).view()
        if array.shape != self.grid.shape:
            raise InputError(
                f"the volume has shape {array.shape}, but its grid needs {self.grid.shape} (z, "
                "y, x)"
            )
        array.flags.writeable = False
        object.__setattr__(self, "array", array)
        object.__setattr__(self, "extras", MappingProxyType(dict(self.extras)))

    # Identity, so that volumes can be keys and parts of what is compared.
    __eq__: ClassVar[Any] = object.__eq__
    __ne__: ClassVar[Any] = object.__ne__
    __hash__: ClassVar[Any] = object.__hash__

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of voxels, (z, y, x)."""
        return self.grid.shape

    @property
    def ndim(self) -> int:
        """Number of axes, 3."""
        return self.array.ndim

    @property
    def dtype(self) -> np.dtype[np.float32]:
        """Type of a voxel, float32."""
        return self.array.dtype

    def min(self, *args: Any, **options: Any) -> Any:
        """Return the smallest voxel, as numpy does, also along an axis."""
        return self.array.min(*args, **options)

    def max(self, *args: Any, **options: Any) -> Any:
        """Return the largest voxel, as numpy does, also along an axis."""
        return self.array.max(*args, **options)

    def mean(self, *args: Any, **options: Any) -> Any:
        """Return the mean of the voxels, as numpy does, also along an axis."""
        return self.array.mean(*args, **options)

    def __len__(self) -> int:
        """Return the number of slices along z."""
        return len(self.array)

    def __getitem__(self, index: Any) -> Any:
        """Return voxels as numpy does for the array (z, y, x)."""
        return self.array[index]

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Apply a function of numpy to the voxels.

        Raises:
            InputError: the inputs are volumes on different grids.
        """
        if any(isinstance(one, Volume) for one in options.get("out", ())):
            return NotImplemented  # the voxels of a volume never change
        for other in inputs:
            if isinstance(other, Volume):
                self.require_grid(other.grid)
        arrays = [one.array if isinstance(one, Volume) else one for one in inputs]
        result = getattr(ufunc, method)(*arrays, **options)
        return self._on_grid(result) if method == "__call__" else result

    def _on_grid(self, result: Any) -> Any:
        """Return numbers on this grid as a volume, and all other results as they are."""
        if isinstance(result, tuple):
            return tuple(self._on_grid(one) for one in result)  # type: ignore[reportUnknownVariableType]
        if getattr(result, "shape", None) == self.shape and result.dtype.kind in "fiu":
            return Volume(result, self.grid)
        return result

    def require_grid(self, grid: VolumeGrid) -> None:
        """Check that another grid has the same voxels, to ``SAME_MM``.

        Raises:
            InputError: the grids differ.
        """
        if self.grid == grid:
            return
        # Four corners that lie in no plane: they fix every voxel.
        corners = np.vstack([np.zeros(3), np.diag(np.array(self.grid.shape_xyz) - 1.0)])
        apart = np.c_[corners, np.ones(4)] @ (self.grid.affine - grid.affine).T
        if self.shape != grid.shape or np.abs(apart).max() > SAME_MM:
            raise InputError(f"two volumes have different grids: {self.grid}, and {grid}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy array, grid and extras."""
        return Volume, (self.array, self.grid, dict(self.extras))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the array, for numpy's functions."""
        return np.array(self.array, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        """Return one line with the numbers of voxels, their edges and the range of their values."""
        voxels = " x ".join(map(str, self.grid.shape_xyz))
        edges = " x ".join(f"{edge:g}" for edge in self.grid.voxel)
        values = f"{self.array.min():.4g} to {self.array.max():.4g}"
        extras = f", extras {', '.join(self.extras)}" if self.extras else ""
        return f"Volume({voxels} voxels of {edges} mm, {values}{extras})"

    def show(self, path: str | Path | io.BytesIO | None = None) -> None:
        """Show the three sections through the grid's middle.

        Args:
            path: file for the picture, such as ``volume.png``, or a buffer for PNG; None opens a
                window, or shows it in the notebook, with sliders if ipywidgets is installed.

        Raises:
            InputError: no path is given, and there is no window; or the file's ending is unknown.
        """
        if path is None and (widgets := notebook_widgets()):
            show_with_sliders(self.array, self.grid, widgets)
        else:
            show(partial(draw_sections, self.array, self.grid), SIZE_INCH, path)

    def _repr_png_(self) -> bytes:
        """Return a PNG image of the three sections, for a notebook."""
        picture = io.BytesIO()
        self.show(picture)
        return picture.getvalue()

    def to_xarray(self) -> Any:
        """Return a labelled view of the voxels, an ``xarray.DataArray`` that shares their memory.

        It has the axes z, y and x in mm along the grid. ``attrs["world_from_index"]`` is the 4 x 4
        matrix from (x, y, z) indices to world mm, which a rotated grid needs.

        Raises:
            InputError: xarray is not installed.
        """
        xarray = optional("xarray", "Volume.to_xarray")
        x, y, z = self.grid.axes()
        attributes = {"units": "1/mm", "world_from_index": self.grid.affine.tolist()}
        axes = {
            name: (name, axis, {"units": "mm"}) for name, axis in zip("zyx", (z, y, x), strict=True)
        }
        return xarray.DataArray(
            self.array, coords=axes, dims=("z", "y", "x"), name="attenuation", attrs=attributes
        )

    def in_hu(self, water_per_mm: float, air_per_mm: float = 0.0) -> Volume:
        """Return the volume in HU, in which air is -1000 and water is 0.

        Args:
            water_per_mm: attenuation of water in this volume, 1/mm.
            air_per_mm: attenuation of air in this volume, 1/mm.

        Raises:
            InputError: water does not attenuate more than air.
        """
        if not water_per_mm > air_per_mm:
            raise InputError(
                f"HU need water that attenuates more than air, not {water_per_mm:g}/mm and "
                f"{air_per_mm:g}/mm"
            )
        scale = (self.array - np.float32(air_per_mm)) / np.float32(water_per_mm - air_per_mm)
        return Volume(np.float32(AIR_HU) * (1 - scale), self.grid)

    @kinds_checked
    def write(
        self,
        path: str | Path,
        note: str = "",
        *,
        to: str | None = None,
        facts: VolumeFacts | None = None,
    ) -> None:
        """Write the volume as a file or a folder, which appears only when it is complete.

        A file is replaced, a folder (DICOM, Zarr) must not exist.

        Args:
            path: the file or folder; its ending states the format: ``.nii``, ``.nii.gz``, ``.mha``,
                ``.tif`` or ``.zarr``.
            note: one line on the origin of the volume.
            to: name of a format, such as ``dicom``; None: by the ending.
            facts: further facts, such as the unit of the voxels; 1/mm by default.

        Raises:
            InputError: the ending or the format is unknown.
            ScanExistsError: the folder exists.
            StorageError: the path cannot be written.
        """
        path = Path(path)
        form = volume_format_named(to) if to else format_of_name(path, volume_formats().values())
        facts = facts or VolumeFacts()
        facts = replace(facts, note=note or facts.note)
        if path.is_dir():
            raise ScanExistsError(f"{path} exists already: choose another name")
        with storage_errors(path), complete(path) as draft:
            form.write(self.array, self.grid, draft, facts)

    @classmethod
    def read(cls, path: str | Path) -> Volume:
        """Read a NIfTI file written by ``write``; its header stores the grid in float32.

        Returns:
            The volume; its extras hold the ``note`` of the header.

        Raises:
            InputError: the file is not readable as NIfTI, or has no voxel grid.
        """
        voxels, image = read_nifti(Path(path), f"{path}: the NIfTI volume")
        try:
            note = bytes(image.header["descrip"].tobytes()).rstrip(b"\0").decode(errors="replace")
            array = voxels.T
            grid = _grid_of(array.shape, np.asarray(image.affine, dtype=np.float64))
        except (ValueError, KeyError) as error:
            raise InputError(f"{path}: not a readable NIfTI volume: {error}") from None
        return cls(array, grid, {"note": note})


def _grid_of(shape: tuple[int, ...], affine: Floats) -> VolumeGrid:
    """Return the grid with a given ``affine``; raise ValueError if there is none."""
    linear, edges = affine[:3, :3], np.linalg.norm(affine[:3, :3], axis=0)
    if len(shape) != 3 or not np.linalg.det(linear) > 0 or not np.isfinite(affine).all():
        raise ValueError(
            f"a voxel grid needs 3 right-handed axes, but there are {len(shape)} with the "
            f"matrix {linear.tolist()}"
        )
    middle = affine @ [*((np.array(shape[::-1]) - 1) / 2), 1.0]
    return VolumeGrid(shape, edges, Pose.from_matrix(middle[:3], linear / edges))
