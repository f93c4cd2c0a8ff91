"""Commands on finished scans: export, report, comparison and reconstruction."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.arguments import Flag, Json, Overrides, Threads
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal, say
from twinct.cli.summary import say_result
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.foreign_text import counted, quoted
from twinct.core.threads import limit_threads
from twinct.link.recording.arms_recording import ArmsRecording


def import_(
    files: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(
            metavar="SOURCE",
            help="YAML description of a measured scan, folder of twinct export, .xtekct or OpenCT "
            "file; or recordings of run --record, or MCAP files of another tool.",
        ),
    ],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    try_: Annotated[Flag, tyro.conf.arg(name="try")] = False,
    arms: ArmsRecording = ArmsRecording(),  # noqa: B008 - frozen
) -> None:
    """Import a measured scan, or a scan's recordings: DIR/scan.zarr and DIR/scenario.yaml.

    A measured scan has images and a geometry, but no truth. The command prints all that it reads,
    with units, and shows it in DIR/imported.png. twinct reconstruct then makes the volumes.

    Several recordings belong to one scan that was interrupted and resumed. Missing views are
    listed; run --resume acquires them. A recording of these topics by another tool is imported,
    with its poses, cameras and images, as a gantry's scan of an unknown specimen.

    From recordings of real arms, made by twinct drive or with --arms.scenario, the executed poses
    are those of the joints at the time of each image.

    Args:
        out: Folder to write, without a run in it.
        try_: For a measured scan: import nothing, but try other conventions (direction of rotation,
            flips, transposed images, exchanged axes, sign and unit of offsets), rank them, and show
            them in DIR/tried.png.
    """
    from twinct.measured import is_measured

    if any(map(is_measured, files)):
        if len(files) > 1:
            raise InputError(f"{len(files)} sources: a measured scan has one; omit {files[1]}")
        (_try_conventions if try_ else _import_measured)(Path(*files), out)
        return
    if try_:
        raise InputError(f"--try: only for a measured scan, not for {', '.join(map(str, files))}")
    if _import_driven(files, out, arms):
        return
    from twinct.runs import import_scan

    imported = import_scan(files, out)
    for problem in imported.contents.problems:
        say(problem, warning=True)
    if imported.missing:
        say(f"missing: {imported.missing_in_words}", warning=True)
    count = len(imported.views)
    say(f"{count} of {count + len(imported.missing)} views imported to {out}")


def _import_driven(files: tuple[Path, ...], out: Path, arms: ArmsRecording) -> bool:
    """Import recordings of real arms; return False if they are none."""
    from twinct.measured import import_driven, is_driven

    require("record")
    if not is_driven(files, arms):
        return False
    require("robots")
    imported = import_driven(files, out, arms)
    for sentence in imported.notes:
        say(sentence, warning=True)
    if imported.lag_ms is not None:
        say(f"the arms followed the plan {imported.lag_ms:.2f} ms late")
    estimated = ", estimated from the images" if arms.estimate_latency else ""
    say(f"images are stamped {imported.latency_ms:.2f} ms after their exposures{estimated}")
    say(f"{counted(imported.views, 'view')} imported to {out}")
    return True


def _import_measured(source: Path, out: Path) -> None:
    from twinct.measured import description_of, import_measured

    with on_terminal() as audience:
        imported = import_measured(description_of(source), out, audience)
    for sentence in imported.notes:
        say(sentence)
    for doubt in imported.doubts:
        say(doubt, warning=True)
    say(f"imported to {out}; {out / 'imported.png'} shows it, 'twinct reconstruct {out}' goes on")


def _try_conventions(source: Path, out: Path) -> None:
    from twinct.core.files.writing import storage_errors
    from twinct.measured import description_of, try_conventions
    from twinct.runs import Folder

    folder = Folder(out)
    folder.refuse_others()
    with on_terminal() as audience:
        ranking = try_conventions(description_of(source), audience)
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        ranking.show(folder.tried)
    for sentence in ranking.notes:
        say(sentence)
    say(f"wrote {folder.tried}; nothing was imported")


def _format_argument() -> Any:
    """Return the type of ``--to``; only commands and help that need it look for formats."""
    from twinct.exchange import formats
    from twinct.recon.volume_formats import volume_formats

    known = formats(), volume_formats()
    scan, volume = ("; ".join(f"{form.name}: {form.title}" for form in of.values()) for of in known)
    metavar = f"{{{','.join(name for of in known for name in of)}}}"
    words = f"Format of the files. A scan: {scan}. A volume (--volume): {volume}."
    return Annotated[str, tyro.conf.arg(metavar=metavar, help=words)]


_SCAN_VALUES = "line-integrals", "transmission"


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
    if volume is not None:
        _export_volume(scan, volume, to, geometry, values, water, air, out)
        return
    _refuse_volumes(to, values, water, air)
    from twinct.runs import export_scan

    with on_terminal() as audience:
        folder = export_scan(
            scan,
            to,
            geometry=geometry,
            values="transmission" if values == "transmission" else "line-integrals",
            out=out,
            observers=audience,
        )
    say(f"wrote {folder}; its README.txt says more")


def _refuse_volumes(to: str, values: str | None, water: float | None, air: float | None) -> None:
    """Raise if arguments of a volume are given, but no volume."""
    from twinct.exchange import formats
    from twinct.recon.volume_formats import volume_formats

    of_scan, of_volume = formats(), volume_formats()
    if to in of_volume and to not in of_scan:
        raise InputError(f"--to {to}: a format of volumes: name a volume with --volume")
    if to not in of_scan and to not in of_scan.broken:
        raise InputError(
            f"--to {quoted(to)}: unknown; choose from {', '.join(of_scan)} for the scan, or from "
            f"{', '.join(of_volume)} for a volume (--volume)"
        )
    for name, value in (("--water", water), ("--air", air), (f"--values {values}", values)):
        if value is not None and value not in _SCAN_VALUES:
            raise InputError(f"{name}: applies to volumes only: name one with --volume")


def _export_volume(
    folder: Path,
    volume: str,
    to: str,
    geometry: str | None,
    values: Any,
    water: float | None,
    air: float | None,
    out: Path | None,
) -> None:
    from twinct.runs import Water, export_volume

    if geometry is not None or values in _SCAN_VALUES:
        name = "--geometry" if geometry is not None else f"--values {values}"
        raise InputError(f"{name}: does not apply to a volume (--volume {volume})")
    if water is not None and values == "attenuation":
        raise InputError(f"--water {water:g}: defines HU, but --values is attenuation")
    if water is None and air is not None:
        raise InputError(f"--air {air:g}: HU need --water, too")
    stated = None if water is None else Water(water, air or 0.0)
    with on_terminal() as audience:
        written = export_volume(
            folder, volume, to, values=values, water=stated, out=out, observers=audience
        )
    say(f"wrote {written}")


def report(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Evaluate a finished run again and rewrite its metrics.json and report.html.

    --set evaluation.KEY=VALUE adds measurements in its volumes; none is reconstructed again. For
    a measured scan, all volumes are judged again by the figures that need no truth.

    Args:
        folder: Folder of twinct run --out, or of twinct import of a measured scan.
    """
    from twinct.runs import rewrite_report
    from twinct.scenario import named_places

    with answering(as_json) as answer:
        with named_places(folder / "scenario.yaml", set_), on_terminal() as audience:
            again = rewrite_report(folder, audience, set_)
        say_result(again)
        answer |= {"report": str(again.paths.report), "figures": again.figures}


def compare(
    folders: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DIR")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="HTML")] = Path("compare.html"),
    as_json: Json = False,
) -> None:
    """Compare finished runs on one page: slices, figures, pose errors, times, and their scenarios.

    Slices show the same places in the same windows; differences refer to the first run. Measured
    scans are compared with each other, by the figures that need no truth.

    Args:
        folders: Folders of twinct run --out, or DIR/reconstructions/NAME for results of
            twinct reconstruct; two or more. A measured scan's folder means all its volumes.
        out: File to write.
    """
    from twinct.core.files.writing import check_page, storage_errors
    from twinct.report.pose_words import named_pose_errors
    from twinct.runs import compare
    from twinct.runs.folder import refuse_result

    check_page(out)
    refuse_result(out)
    with answering(as_json) as answer:
        with on_terminal() as audience:
            comparison = compare(folders, audience)
        for note in comparison.notes:
            say(note, warning=True)
        with storage_errors(out):
            out.parent.mkdir(parents=True, exist_ok=True)
            comparison.write(out)
        differ = "differs" if len(comparison.keys) == 1 else "differ"
        say(f"wrote {out}: {counted(len(comparison.keys), 'scenario key')} {differ}")
        answer |= {"page": str(out), "notes": comparison.notes, "keys": comparison.keys}
        answer["runs"] = [
            {"path": one.path, "label": one.label, "image": one.image, "seconds": one.seconds}
            | ({"pose_errors": named_pose_errors(one.metrics)} if comparison.has_truth else {})
            for one in comparison.compared
        ]


def verify(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    as_json: Json = False,
) -> None:
    """Compare each file of a scan with its stored digest, and check its results.

    Exits with 1 if anything is damaged, missing or unfinished; 'twinct run --resume' acquires
    damaged parts of a scan again.

    Args:
        folder: Folder of twinct run --out, or its scan.zarr.
    """
    from twinct.runs import verify

    with answering(as_json) as answer:
        damages = verify(folder)
        for problem in damages.problems:
            say(problem, warning=True)
        for file in damages.unknown:
            say(f"{file}: unknown file, ignored")
        state = counted(len(damages.problems), "problem") if damages.problems else "intact"
        say(f"{folder}: {state} ({damages.in_words})")
        answer |= {"intact": not damages.problems, "problems": damages.problems}
        answer["unknown"] = [str(file) for file in damages.unknown]
    if damages.problems:
        sys.exit(1)


def reconstruct(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    geometry: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    as_: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None,
    threads: Threads = None,
    halves: Flag = False,
    set_: Overrides = (),
) -> None:
    """Reconstruct a finished run again, beside its volume, and show both in its report.

    Or reconstruct a measured scan, and judge the volume by the figures that need no truth.

    Args:
        folder: Folder of twinct run --out, or of twinct import of a measured scan.
        geometry: commanded, executed, believed, or one made by twinct geometry.
        as_: Name of the result, below DIR/reconstructions; by default, it follows the algorithm.
        halves: For a measured scan: also reconstruct the even and the odd views, for the noise.
    """
    from twinct.evaluation.figure import REFERENCE
    from twinct.runs import reconstruct_run
    from twinct.runs.folder import read_metrics
    from twinct.scenario import named_places

    limit_threads(threads)
    how = {"geometry": geometry, "name": as_, "halves": halves}
    with named_places(folder / "scenario.yaml", set_), on_terminal() as audience:
        made = reconstruct_run(folder, set_, **how, observers=audience)
    material = read_metrics(folder / "metrics.json").get("reference_material", REFERENCE)
    say(f"{made.judged_in_words(material)}\n{made.path}; report: {folder / 'report.html'}")


def geometry(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    as_: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None,
    set_: Overrides = (),
) -> None:
    """List the geometries of a scan, or derive a new one: poses that its robots would report.

    Args:
        folder: Folder of twinct run --out.
        as_: Name of the new geometry; without it, existing geometries are listed.
        set_: Keys of uncertainty, such as --set uncertainty.seed=3.
    """
    from twinct.evaluation import pose_errors
    from twinct.runs import derive_geometry, load_scan

    if as_ is not None:
        with on_terminal() as audience:
            derive_geometry(folder, as_, set_, audience)
    elif set_:
        raise InputError(f"--set {set_[0]}: a new geometry needs a name (--as)")
    scan = load_scan(folder)
    taken = scan.provenance.kept
    table = Table("geometry", f"source to {taken}, mm", f"detector to {taken}, mm", "made by")
    for name in scan.geometries:
        errors = pose_errors(scan.poses(taken), scan.poses(name))
        means = (f"{arm.position_mm.mean():.4f}" for arm in (errors.source, errors.detector))
        made_by = scan.derived[name].made_by if name in scan.derived else {}
        words = ", ".join(f"{k} {v}" for k, v in made_by.items() if not isinstance(v, dict))
        table.add_row(name, *means, words)
    Console().print(table)
