"""Load this folder into LEAP (github.com/LLNL/LEAP), and reconstruct it with LEAP's SART."""
# pyright: reportMissingImports=false

import argparse
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


def arrays():
    """Return the images (view, row, column), and LEAP's arguments by name."""
    with np.load(HERE / "geometry.npz") as stored:
        return np.load(HERE / "projections.npy"), dict(stored)


def load():
    """Return LEAP's model with geometry and volume, and the images."""
    from leapctype import tomographicModels

    images, words = arrays()
    model = tomographicModels()
    sizes = *words["detector"].tolist(), *words["pixel"].tolist()
    vectors = (words[k] for k in ("sourcePositions", "moduleCenters", "rowVectors", "colVectors"))
    done = model.set_modularbeam(len(images), *sizes, *vectors)
    done = done and model.set_volume(*words["volume"].tolist(), *words["voxel"].tolist())
    if not done:
        raise SystemExit("LEAP rejected the geometry; its output above says why")
    model.set_diameterFOV(1.0e16)  # reconstruct the corners of the grid too
    return model, images


def reconstruct(iterations):
    """Reconstruct with SART in ten subsets of views; return the volume (z, y, x)."""
    model, images = load()
    volume = model.allocateVolume()
    volume[:] = 0
    model.SART(images, volume, iterations, min(10, len(images)))
    return volume


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--iterations", type=int, default=0, help="iterations to reconstruct; 0 only loads"
    )
    parser.add_argument("--out", type=Path, default=Path("volume.npy"))
    options = parser.parse_args()
    leap, stack = load()
    leap.print_parameters()
    print(f"images (view, row, column) {stack.shape}")
    if options.iterations:
        np.save(options.out, reconstruct(options.iterations))
        print(f"wrote {options.out}")
