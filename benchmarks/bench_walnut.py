"""A measured walnut: our volumes against RTK's FDK, which reads the numbers of the file itself.

    tools/fetch-walnut
    python benchmarks/bench_walnut.py [--voxels 256] [--out DIR]

``twinct import`` and ``twinct reconstruct`` make the volumes of ``fdk`` and ``fast``. RTK gets
the stored images, unturned, less the integral of air (as in the example), and a circle by its own
parameters (source to axis, source to panel, gantry angle): it shares nothing of the import.
Root mean square differences are relative to
that of RTK's volume, in the voxels that every view sees. Seconds are of the wall; a busy machine
takes longer. ``--picture FILE`` draws a plane of each.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from twinct.evaluation import region_of_interest
from twinct.measured import description_of, import_measured
from twinct.runs import load_scan, reconstruct_run

ROOT = Path(__file__).parents[1]


def rtk_fdk(voxels: int, edge_mm: float) -> tuple[np.ndarray, float]:
    """Return RTK's volume (z, y, x), turned to the axes of the import, and its seconds."""
    itk: Any = import_module("itk")

    RTK: Any = itk.RTK
    data = np.load(ROOT / "data" / "walnut_cone.npz")
    sod, sdd, pitch = (float(data[name]) for name in ("sid", "sdd", "du"))
    images = data["sinogram"].astype(np.float32)
    images += np.log(np.exp(-images[:, :200, :8]).mean(axis=(1, 2)))[:, None, None]
    geometry = RTK.ThreeDCircularProjectionGeometry.New()
    for angle in np.degrees(data["angles"].astype(np.float64)):
        geometry.AddProjection(sod, sdd, float(-angle))

    def image(array: np.ndarray, spacing: tuple[float, ...], centred: int) -> Any:
        made = itk.image_view_from_array(array)
        made.SetSpacing(spacing)
        shape = array.shape[::-1]
        origin = [
            -(n - 1) / 2 * s if axis < centred else 0.0
            for axis, (n, s) in enumerate(zip(shape, spacing, strict=True))
        ]
        made.SetOrigin(origin)
        return made

    volume = np.zeros((voxels,) * 3, np.float32)
    kind = itk.Image[itk.F, 3]
    fdk = RTK.FDKConeBeamReconstructionFilter[kind].New()
    fdk.SetInput(0, image(volume, (edge_mm,) * 3, 3))
    fdk.SetInput(1, image(images, (pitch, pitch, 1.0), 2))
    fdk.SetGeometry(geometry)
    start = time.perf_counter()
    fdk.Update()
    seconds = time.perf_counter() - start
    found = np.array(itk.array_from_image(fdk.GetOutput()))
    # RTK turns about its y, which runs with the rows, down: Z = -x, Y = -z, X = y.
    return found[::-1, ::-1].transpose(1, 2, 0), seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--voxels", type=int, default=256)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--picture", type=Path)
    told = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = told.out or Path(scratch) / "walnut"
        import_measured(description_of(ROOT / "examples" / "walnut.yaml"), folder)
        scan = load_scan(folder)
        whole = scan.settings.reconstruction.grid
        edge = float(whole.volume_grid.voxel[0]) * 256 / told.voxels
        grid = [
            f"reconstruction.grid.voxels={told.voxels}",
            f"reconstruction.grid.voxel_mm={edge!r}",
        ]
        made = {
            name: reconstruct_run(folder, [f"reconstruction.algorithm={name}", *grid])
            for name in ("fdk", "fast")
        }
        rtk, seconds = rtk_fdk(told.voxels, edge)
        volumes = {name: one.volume for name, one in made.items()}
        region = region_of_interest(scan.geometry(), volumes["fdk"].grid)
        scale = np.sqrt(np.mean(rtk[region] ** 2))
        print(f"{told.voxels}^3 voxels of {edge:.4g} mm; RTK FDK {seconds:.1f} s")
        for name, one in made.items():
            off = np.sqrt(np.mean((volumes[name].array - rtk)[region] ** 2)) / scale
            print(
                f"{name}: {one.seconds:.1f} s, {one.figures.in_words('')}, from RTK's FDK "
                f"{100 * off:.2f} % RMS"
            )
        if told.picture:
            draw(told.picture, {"RTK FDK": rtk, **{n: v.array for n, v in volumes.items()}}, edge)


def draw(path: Path, volumes: dict[str, np.ndarray], edge_mm: float) -> None:
    """Draw the middle plane and the middle upright plane of each volume."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.4 * len(volumes), 6.8), layout="constrained")
    axes = figure.subplots(2, len(volumes))
    half = len(next(iter(volumes.values()))) * edge_mm / 2
    for column, (name, array) in enumerate(volumes.items()):
        for row, (plane, up) in enumerate(
            ((array[len(array) // 2], "y"), (array[:, len(array) // 2], "z"))
        ):
            at = axes[row, column]
            at.imshow(
                plane, cmap="gray", vmin=0, vmax=0.06, origin="lower", extent=(-half, half) * 2
            )
            at.set(title=name, xlabel="x / mm", ylabel=f"{up} / mm")
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main()
