"""Load this folder into the ASTRA Toolbox (pip install astra-toolbox); its SIRT needs CUDA."""
# pyright: reportMissingImports=false

import argparse
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


def arrays():
    """Return the images (view, row, column), and the arguments of ASTRA's geometries by name."""
    with np.load(HERE / "geometry.npz") as stored:
        return np.load(HERE / "projections.npy", mmap_mode="r"), dict(stored)


def load():
    """Return ASTRA's projection geometry, its volume geometry, and the images in its axis order."""
    import astra

    images, words = arrays()
    rows, columns = words["detector"].tolist()
    views = astra.create_proj_geom("cone_vec", rows, columns, words["vectors"])
    voxels = astra.create_vol_geom(*words["volume"].tolist(), *words["window"].tolist())
    return views, voxels, np.ascontiguousarray(np.swapaxes(images, 0, 1))  # (row, view, column)


def reconstruct(iterations):
    """Reconstruct with SIRT; return the volume (z, y, x)."""
    import astra

    views, voxels, images = load()
    sinogram = astra.data3d.create("-sino", views, images)
    volume = astra.data3d.create("-vol", voxels, 0)
    config = astra.astra_dict("SIRT3D_CUDA")
    config["ProjectionDataId"], config["ReconstructionDataId"] = sinogram, volume
    algorithm = astra.algorithm.create(config)
    astra.algorithm.run(algorithm, iterations)
    return astra.data3d.get(volume)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--iterations", type=int, default=0, help="iterations to reconstruct; 0 only loads"
    )
    parser.add_argument("--out", type=Path, default=Path("volume.npy"))
    options = parser.parse_args()
    geometry, grid, stack = load()
    print(f"{len(geometry['Vectors'])} views, images (row, view, column) {stack.shape}")
    if options.iterations:
        np.save(options.out, reconstruct(options.iterations))
        print(f"wrote {options.out}")
