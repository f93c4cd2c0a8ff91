"""``twinct dose``: dose of a path to the specimen."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.arguments import Json, Overrides, ScenarioFile, Threads
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal, say
from twinct.cli.scenario_at import scenario_at
from twinct.core.threads import limit_threads
from twinct.runs import dosing


def dose(
    scenario: ScenarioFile,
    *,
    photons: float = dosing.PHOTONS,
    voxel_mm: float = dosing.VOXEL_MM,
    seed: int = 0,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    threads: Threads = None,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Compute the dose of a scenario's views to its parts and labels.

    Photons are followed through voxels, scattered ones too. The table has mean doses with standard
    errors, and what a C-arm would report.

    Args:
        photons: Photons that are followed, in all views together, such as 1e7.
        voxel_mm: Edge of the voxels that stand for the specimen.
        seed: Seed of the random numbers.
        out: Folder for dose.json, and dose.nii with the dose of each voxel in Gy.
    """
    limit_threads(threads)
    with answering(as_json) as answer:
        with scenario_at(scenario, set_) as loaded, on_terminal() as audience:
            made = dosing.dose(
                loaded,
                photons=int(photons),
                voxel_mm=voxel_mm,
                seed=seed,
                out=out,
                observers=audience,
            )
        _show(made, loaded.name)
        if out is not None:
            say(f"wrote {out}")
        answer |= made.data


def _show(made: dosing.Dose, title: str) -> None:
    """Print all doses."""
    path = made.path
    table = Table(title=f"{title}: mean dose")
    for name in ("", "mGy", "standard error", "of it unscattered", "mass, g"):
        table.add_column(name)
    for n, name in enumerate(path.names):
        gray = float(path.doses[n])
        shares = [100 * float(part) / gray if gray else 0.0 for part in _parts(path, n)]
        table.add_row(
            name,
            f"{1000 * gray:.4g}",
            f"{shares[0]:.2g} %",
            f"{shares[1]:.0f} %",
            f"{path.masses_g[n]:.4g}",
        )
    Console().print(table)
    if made.reference_kerma_gy is not None:
        say(f"air kerma at the reference point: {1000 * made.reference_kerma_gy:.4g} mGy")
    say(f"kerma-area product: {made.kerma_area_product_gy_cm2:.4g} Gy cm^2")
    if made.effective.sievert is not None:
        say(f"effective dose: {1000 * made.effective.sievert:.4g} mSv")


def _parts(path: dosing.PathDose, place: int) -> tuple[float, float]:
    return float(path.errors[place]), float(path.unscattered[place])
