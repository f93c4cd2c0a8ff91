"""``twinct ctsimu``: import and export of CTSimU scenarios, and the qualification suite."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.arguments import Flag
from twinct.cli.optional import mark_optional
from twinct.cli.progress import on_terminal
from twinct.core.errors import InputError, MemoryShortageError
from twinct.core.files.writing import check_folder
from twinct.core.interruption import keeping
from twinct.ctsimu import Options, load_ctsimu, suite
from twinct.ctsimu import render as render_ctsimu
from twinct.ctsimu.export import export_scan
from twinct.ctsimu.outputs import OutputPaths
from twinct.ctsimu.scenario import CtsimuScenario
from twinct.scan import ScanStore, SimulationBuilder, named_geometries

ctsimu = tyro.extras.SubcommandApp()

MOST_SAMPLES = 64
"""Largest number of samples along a pixel's edge: 4096 rays per pixel."""

MOST_SPOT_POINTS = 10_000
"""Largest number of points of a focal spot; each needs a render of the whole panel."""


@ctsimu.command
@mark_optional
def render(
    scenario: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE.json")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    samples: int = 3,
    spot_points: int = 32,
    seed: int = 0,
    resume: Flag = False,
) -> None:
    """Render a CTSimU scenario: TIFF projections, dark and flat images, metadata.

    Writes NAME_0000.tif ..., NAME_dark.tif, NAME_flat.tif and NAME_metadata.json into DIR.

    Args:
        scenario: CTSimU scenario, file format 1.0 to 1.2.
        out: Folder for the images; existing images are never changed without --resume.
        samples: Rays along each pixel edge for a point source, 1 to 64; the time grows with the
            square.
        spot_points: Points that sample an extended focal spot, 1 to 10000; the time grows in
            proportion.
        seed: Seed of the noise, 0 or more.
        resume: Resume an interrupted rendering.
    """
    _check_options(samples, spot_points, seed)
    check_folder(out)
    loaded = load_ctsimu(scenario)
    options = Options(samples, spot_points, seed)
    try:
        with (
            on_terminal() as audience,
            audience.stage("projections", loaded.frames) as step,
            keeping(partial(_kept, loaded, out)),
        ):
            files = render_ctsimu(loaded, out, options, resume=resume, step=step)
    except MemoryError as error:
        columns, rows = reversed(loaded.frame(0).panel.shape)
        raise MemoryShortageError(
            f"{scenario}: a panel of {columns} x {rows} pixels does not fit into memory: {error}"
        ) from None
    Console().print(f"wrote {files.metadata}", highlight=False)


@ctsimu.command
@mark_optional
def export(
    scan: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SCAN")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    ideal: Flag = False,
    geometry: Annotated[str, tyro.conf.arg(metavar="NAME")] = "believed",
) -> None:
    """Write a finished scan as a CTSimU scenario and as an OpenCT free trajectory.

    Writes NAME.json, NAME_openCT.json, a mesh for each part and the projections into DIR.

    Args:
        scan: Folder of twinct run --out, or its scan.zarr.
        out: Folder for the files.
        ideal: Describe an ideal source and detector, whatever the scan used.
        geometry: Geometry for the reconstruction: believed, executed, commanded, or one made by
            twinct geometry.
    """
    store = scan if scan.suffix == ".zarr" else scan / "scan.zarr"
    if not store.is_dir():
        raise InputError(f"{scan} holds no scan; expected a scan.zarr, as 'twinct run' writes it")
    check_folder(out)
    taken = replace(ScanStore(store).read(), derived=named_geometries(store.parent / "geometries"))
    specimen = SimulationBuilder(taken.scenario).specimen
    files = export_scan(taken, specimen, out, ideal=ideal, geometry=geometry)
    console = Console()
    console.print(f"wrote {files.scenario} and {files.trajectory}", highlight=False)
    if files.options:
        how = f"render it with {files.options} to get the scan's own images"
        console.print(how, highlight=False)


@ctsimu.command
@mark_optional
def qualify(
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    tests: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TEST")] = (),
) -> None:
    """Run the CTSimU qualification suite and evaluate our images with BAM's toolbox.

    Exits with 1 if a required figure is not reached. Existing images are not rendered again.

    Args:
        out: Folder for samples, images and results; figures go to qualification.json.
        tests: Names such as 2D-FB-1; by default, all supported tests, eight of ten.
    """
    check_folder(out)
    console, say = Console(), partial(Console(stderr=True).print, highlight=False)
    table = Table("test", "figure", "required", "measured", "")
    marks = {True: "passed", False: "FAILED", None: ""}
    with keeping(lambda: f"{out} keeps its images; the same command continues"):
        verdicts = suite.qualify(out, tests or suite.TESTS, step=say)
    for v in verdicts:
        table.add_row(v.test, v.what, v.required, v.measured, marks[v.passed])
    console.print(table)
    for name, why in suite.NOT_TAKEN.items():
        console.print(f"{name} is skipped: {why}", highlight=False)
    if any(verdict.passed is False for verdict in verdicts):
        raise SystemExit(1)


def _kept(scenario: CtsimuScenario, out: Path) -> str:
    files = OutputPaths(out, scenario.name)
    done = sum(files.projection(index).exists() for index in range(scenario.frames))
    return f"{out} keeps {done} of {scenario.frames} projections; --resume continues"


def _check_options(samples: int, spot_points: int, seed: int) -> None:
    wrong = []
    for name, value, least, most in (
        ("samples", samples, 1, MOST_SAMPLES),
        ("spot-points", spot_points, 1, MOST_SPOT_POINTS),
        ("seed", seed, 0, math.inf),
    ):
        if not least <= value <= most:
            limit = f"at least {least}" if value < least else f"at most {most}"
            wrong.append(f"--{name} {value}: must be {limit}")
    if wrong:
        raise InputError(wrong)
