"""``twinct export``: a scan or a volume for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from twinct import runs
from twinct.cli.progress import on_terminal, say
from twinct.exchange import formats
from twinct.recon.volume_formats import volume_formats


def _format_argument() -> Any:
    """Return the type of ``--to``; extensions are looked up for it."""
    known = formats(), volume_formats()
    scan, volume = ("; ".join(f"{form.name}: {form.title}" for form in of.values()) for of in known)
    metavar = f"{{{','.join(name for of in known for name in of)}}}"
    words = f"Format of the files. A scan: {scan}. A volume (--volume): {volume}."
    return Annotated[str, tyro.conf.arg(metavar=metavar, help=words)]


def export(
    scan: Annotated[
        tyro.conf.Positional[Path],
        tyro.conf.arg(metavar="SCAN", help="Folder of twinct run --out, or the scan.zarr in it."),
    ],
    *,
    to: Annotated[str, tyro.conf.arg(constructor_factory=_format_argument)],
    volume: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    geometry: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    values: Literal["line-integrals", "transmission", "attenuation", "hounsfield"] | None = None,
    water: Annotated[float | None, tyro.conf.arg(metavar="MU")] = None,
    air: Annotated[float | None, tyro.conf.arg(metavar="MU")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None,
) -> None:
    """Write a scan in a form that another toolkit can reconstruct directly, or one of its volumes.

    For a scan, PATH gets the projections, the geometry, the scenario's voxel grid, a script load.py
    that loads them into the toolkit and reconstructs, and a README. For a scan in progress,
    it gets the existing views. With --volume, PATH is the file or folder of the volume.

    Args:
        volume: Write a volume instead of the scan: volume (of the run), truth, or a result of
            twinct reconstruct.
        geometry: believed (reported by the system; default), executed (true poses of the arms),
            commanded (requested poses), or one made by twinct geometry.
        values: Pixels of a scan as -ln(I/I0) (default) or as I/I0; voxels of a volume as
            attenuation in 1/mm (default) or in HU (default of dicom, where water is known).
        water: Attenuation of water in the volume, 1/mm, which becomes 0 HU; by default, that for
            the scenario's beam. A measured scan needs it for HU.
        air: Attenuation of air in the volume, 1/mm, which becomes -1000 HU; by default, 0.
        out: File or folder to write, which must not exist; by default, export-NAME beside the scan.
    """
    with on_terminal() as audience:
        written = runs.export(
            scan,
            to,
            volume=volume,
            geometry=geometry,
            values=values,
            water=water,
            air=air,
            out=out,
            observers=audience,
        )
    say(f"wrote {written}" if volume else f"wrote {written}; its README.txt says more")
