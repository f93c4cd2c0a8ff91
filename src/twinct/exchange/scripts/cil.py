"""Load this folder into CIL (conda packages cil and astra-toolbox); its SIRT needs CUDA.

CIL must be recent enough to have Cone3D_Flex.
"""
# pyright: reportMissingImports=false

import argparse
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


def arrays():
    """Return the images (view, row, column), and CIL's arguments by name."""
    with np.load(HERE / "geometry.npz") as stored:
        return np.load(HERE / "projections.npy"), dict(stored)


def load():
    """Return CIL's acquisition data with its geometry, and the image geometry of the volume."""
    from cil.framework import AcquisitionData, AcquisitionGeometry, ImageGeometry

    images, words = arrays()
    views = AcquisitionGeometry.create_Cone3D_Flex(
        words["source_position_set"],
        words["detector_position_set"],
        words["detector_direction_x_set"],
        words["detector_direction_y_set"],
        volume_centre_position=[0, 0, 0],
        units="mm",
    )
    pixels, pitch = words["num_pixels"].tolist(), words["pixel_size"].tolist()
    views.set_panel(pixels, pitch, origin="bottom-left")
    # CIL's axis order equals the file's: view, vertical, horizontal.
    data = AcquisitionData(images, deep_copy=False, geometry=views)
    data.reorder("astra")
    return data, ImageGeometry(*words["volume"].tolist(), *words["voxel"].tolist())


def reconstruct(iterations):
    """Reconstruct with SIRT; return the volume (z, y, x)."""
    from cil.optimisation.algorithms import SIRT
    from cil.plugins.astra import ProjectionOperator

    data, voxels = load()
    operator = ProjectionOperator(voxels, data.geometry, device="gpu")
    sirt = SIRT(initial=voxels.allocate(0), operator=operator, data=data)
    sirt.run(iterations)
    return sirt.solution.as_array()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--iterations", type=int, default=0, help="iterations to reconstruct; 0 only loads"
    )
    parser.add_argument("--out", type=Path, default=Path("volume.npy"))
    options = parser.parse_args()
    print(load()[0].geometry)
    if options.iterations:
        np.save(options.out, reconstruct(options.iterations))
        print(f"wrote {options.out}")
