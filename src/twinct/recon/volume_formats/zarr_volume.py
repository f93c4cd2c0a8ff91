"""Volumes as Zarr groups with the metadata of OME-Zarr 0.5 (https://ngff.openmicroscopy.org/0.5).

OME-Zarr states edges and a shift, and no turn: ``world_from_voxel`` holds the whole place.
"""

from __future__ import annotations

from pathlib import Path

from twinct.geometry import VolumeGrid
from twinct.recon.volume_formats.volume_format import Singles, VolumeFacts, VolumeFormat

CHUNK = 64


def _write(array: Singles, grid: VolumeGrid, path: Path, volume_facts: VolumeFacts) -> None:
    import zarr

    group = zarr.open_group(path, mode="w", zarr_format=3)
    chunks = tuple(min(CHUNK, count) for count in array.shape)
    group.create_array("0", data=array, chunks=chunks, dimension_names=("z", "y", "x"))
    edges = [float(edge) for edge in grid.voxel[::-1]]
    shift = [float(at) for at in grid.affine[2::-1, 3]]
    group.attrs["ome"] = {
        "version": "0.5",
        "multiscales": [
            {
                "name": volume_facts.scan,
                "axes": [{"name": n, "type": "space", "unit": "millimeter"} for n in "zyx"],
                "datasets": [
                    {
                        "path": "0",
                        "coordinateTransformations": [
                            {"type": "scale", "scale": edges},
                            {"type": "translation", "translation": shift},
                        ],
                    }
                ],
            }
        ],
    }
    facts = {
        "values": volume_facts.unit,
        "note": volume_facts.note,
        "world_from_voxel": grid.affine.tolist(),
    }
    group.attrs["twinct"] = facts


ZARR = VolumeFormat("zarr", "Zarr 3 with the metadata of OME-Zarr 0.5", (".zarr",), _write)
