"""Load this folder into TIGRE (github.com/CERN/TIGRE), and run its SART on a CUDA card.

Rays and pixels are exact in any view. But TIGRE's back projection is weighted as if the views
rotated about z. In its SART, with one view per update, most of that weight cancels; in its CGLS it
does not.
"""
# pyright: reportMissingImports=false

import argparse
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
PER_VIEW = ("DSO", "DSD", "offOrigin", "offDetector", "rotDetector")
SIZES = ("nDetector", "dDetector", "nVoxel", "dVoxel")


def arrays():
    """Return the images (view, row, column), and TIGRE's attributes by name."""
    with np.load(HERE / "geometry.npz") as stored:
        return np.load(HERE / "projections.npy"), dict(stored)


def load():
    """Return TIGRE's geometry, its angles, and the images."""
    import tigre

    images, words = arrays()
    geometry = tigre.geometry(mode="cone")
    for name in PER_VIEW + SIZES:
        setattr(geometry, name, words[name])
    geometry.sDetector = geometry.nDetector * geometry.dDetector
    geometry.sVoxel = geometry.nVoxel * geometry.dVoxel
    geometry.accuracy = 0.5
    angles = words["angles"].astype(np.float32)
    geometry.check_geo(angles)
    return geometry, angles, images


def reconstruct(iterations, relaxation=0.3):
    """Reconstruct with SART, one view per update; return the volume (z, y, x)."""
    from tigre import algorithms

    geometry, angles, images = load()
    return algorithms.sart(images, geometry, angles, iterations, lmbda=relaxation)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--iterations", type=int, default=0, help="iterations to reconstruct; 0 only loads"
    )
    parser.add_argument("--out", type=Path, default=Path("volume.npy"))
    options = parser.parse_args()
    print(load()[0])
    if options.iterations:
        np.save(options.out, reconstruct(options.iterations))
        print(f"wrote {options.out}")
