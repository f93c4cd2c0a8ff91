"""Read this folder with NumPy. Programs that support OpenCT open openct.json directly."""

import json
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


def arrays():
    """Return the images (view, row, column), first row on top, and the matrices (view, 3, 4)."""
    words = json.loads((HERE / "openct.json").read_text())
    columns, rows = words["geometry"]["detectorPixel"]
    stored = words["projections"]["images"]
    files = [HERE / stored["directory"] / name for name in stored["files"]]
    images = np.stack([np.fromfile(file, "<f4").reshape(rows, columns) for file in files])
    return images, np.array(words["projections"]["matrices"])


if __name__ == "__main__":
    pixels, projection = arrays()
    print(f"images (view, row, column) {pixels.shape}, matrices {projection.shape}")
