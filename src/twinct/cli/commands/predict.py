"""``twinct predict``: a scan rendered again, beside its images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import Overrides, Threads
from twinct.cli.progress import on_terminal, say
from twinct.core.threads import limit_threads
from twinct.measured import prediction
from twinct.scan.named_geometries import named_geometries
from twinct.scenario import named_places


def predict(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    geometry: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    mesh: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    material: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    as_: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None,
    threads: Threads = None,
    set_: Overrides = (),
) -> None:
    """Render a scan again and compare it with its images, view by view.

    The even views are reconstructed and predict the odd ones; with --mesh, the mesh predicts all
    views. The poses are those of a geometry, the beam is the scenario's. The residuals show errors
    of calibration, spectrum and scatter: prediction.png, prediction.json, views.csv and
    residuals.tif in DIR/predictions. After an interruption the same command goes on from the last
    checkpoint, if the algorithm has any.

    Args:
        folder: Folder of twinct run --out, or of twinct import of a measured scan.
        geometry: believed (default), executed, commanded, or one made by twinct calibrate.
        mesh: Mesh of the object in mm, in the world; --set specimen.position_mm=... moves it.
        material: Material of the mesh; or of the voxels, if a spectrum is stated. Water by default.
        as_: Name of the result, below DIR/predictions; by default, volume or the mesh's name.
        set_: Keys of source, detector, specimen, reconstruction or xray, for the prediction only.
    """
    limit_threads(threads)
    how = {"geometry": geometry, "mesh": mesh, "material": material, "name": as_}
    with named_places(folder / "scenario.yaml", set_), on_terminal() as audience:
        made = prediction.predict(folder, set_, **how, observers=audience)
    for sentence in made.notes:
        say(sentence)
    if geometry is None and (others := ", ".join(named_geometries(folder / "geometries"))):
        say(f"geometries that calibrations made, for --geometry: {others}")
    say(f"{made.path}; picture: {made.path / 'prediction.png'}")
