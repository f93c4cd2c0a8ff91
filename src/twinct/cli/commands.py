"""What each command takes, and which functions it calls; the work is done elsewhere."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.ctsimu import ctsimu
from twinct.cli.progress import on_terminal, say
from twinct.cli.study import study
from twinct.cli.view import live_page, view_command
from twinct.scenario import load_scenario, named_places, scenario_schema

if TYPE_CHECKING:
    from twinct.runs import Run
    from twinct.scan import Workshop

app = tyro.extras.SubcommandApp()

ScenarioFile = Annotated[
    tyro.conf.Positional[Path],
    tyro.conf.arg(metavar="SCENARIO", help="Scenario file (YAML), such as scenarios/demo.yaml."),
]
Overrides = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]],
    tyro.conf.arg(
        name="set",
        metavar="KEY=VALUE",
        help="Override a key of the scenario, such as --set detector.columns=320; may be given "
        "several times.",
    ),
]
MIDDLE = -1
"""Stands for the view in the middle of the scan."""

Threads = Annotated[
    int | None,
    tyro.conf.arg(
        metavar="N",
        help="Threads that each process may use (default: TWINCT_THREADS, or all there are).",
    ),
]
Flag = tyro.conf.FlagCreatePairsOff[bool]

LOOPBACK, PAGE_PORT = "127.0.0.1", 8080
Host = Annotated[str, tyro.conf.arg(help="Address that the page listens on.")]
Port = Annotated[int, tyro.conf.arg(help="Port of the page; 0: any that is free.")]
Network = Annotated[
    Flag, tyro.conf.arg(help="Let --host be another than loopback; the page has no password.")
]


@app.command
def check(
    scenario: ScenarioFile,
    *,
    save: Annotated[Path | None, tyro.conf.arg(metavar="NPZ")] = None,
    picture: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("view.png"),
    set_: Overrides = (),
) -> None:
    """Validate a scenario, build its specimen and plan its motion, without running it.

    Names every view that an arm cannot reach or that would collide, a change that would cure that,
    and draws the first of them.

    Args:
        save: File to write the plan to; with the key motion.plan a scenario follows it.
        picture: File for the picture of a view that cannot be had.
    """
    from twinct.cli.reach import explained
    from twinct.runs import (
        check_geometries,
        check_physics,
        check_sight,
        findings,
        require_extras,
        require_feasible,
        require_memory,
    )
    from twinct.scan import Workshop

    loaded = load_scenario(scenario, set_)
    require_extras(loaded)
    workshop = Workshop(loaded)
    with named_places(scenario, set_):
        require_memory(loaded)
        check_geometries(loaded)
        if workshop.plan_chooses:  # else what the views see is known without a plan
            with explained(workshop, picture):
                _ = workshop.plan
        check_physics(workshop)
        require_feasible(loaded, workshop.commanded)
        for warning in check_sight(workshop):
            say(warning, warning=True)
        with explained(workshop, picture):
            _ = workshop.plan
        table = Table(title=f"{loaded.name}: can be run", show_header=False)
        for name, words in findings(workshop).items():
            table.add_row(name, words.replace("×", "x"))
        if save is not None:
            _save_plan(workshop, save)
    Console().print(table)


def _save_plan(workshop: Workshop, path: Path) -> None:
    from twinct.errors import InputError
    from twinct.motion import save_plan

    if workshop.followed is None:
        why = "a gantry" if workshop.plan is None else "motion.scheme: reactive"
        raise InputError(f"--save {path}: {why} follows no plan")
    if path.suffix != ".npz":
        raise InputError(f"--save {path}: the file of a plan ends in .npz")
    save_plan(workshop.followed, path)


@app.command
def run(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    link: Literal["ros2", "local"] = "ros2",
    resume: Flag = False,
    record: Flag = False,
    view: Flag = False,
    host: Host = LOOPBACK,
    port: Port = PAGE_PORT,
    allow_network: Network = False,
    threads: Threads = None,
    set_: Overrides = (),
) -> None:
    """Run a scenario: plan, move, expose, reconstruct, judge, report.

    Writes scan.zarr, volume.nii, metrics.json, report.html and twinct.log into DIR.

    Args:
        out: Folder for the results; a scan that is there is never touched without --resume.
        link: ros2 starts both simulations as processes; local runs them in this one.
        resume: Go on with a scan that was interrupted.
        record: Write all messages of the scan to DIR/scan.mcap, which ROS tools read.
        view: Show the run on a page while it goes on, see twinct view; the page stays when the run
            is over, until Ctrl-C.
    """
    from twinct import runs
    from twinct.scan import Workshop

    loaded = load_scenario(scenario, set_)
    with ExitStack() as page:
        live, workshop = [], None
        if view:
            workshop = Workshop(loaded)  # what the run builds the page need not build again
            told = live_page(out, workshop, host, port, allow_network)
            live = [page.enter_context(told).observer]
        with named_places(scenario, set_), on_terminal(live) as audience:
            finished = runs.run(
                loaded,
                out,
                link=link,
                resume=resume,
                record=record,
                threads=threads,
                workshop=workshop,
                observers=audience,
            )
        _say_result(finished)


@app.command
def view(
    targets: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(
            metavar="SCENARIO|DIR",
            help="Scenario file, or what twinct run --out wrote; two folders: side by side.",
        ),
    ],
    *,
    host: Host = LOOPBACK,
    port: Port = PAGE_PORT,
    allow_network: Network = False,
    export: Annotated[Path | None, tyro.conf.arg(metavar="HTML")] = None,
    movie: Annotated[Path | None, tyro.conf.arg(metavar="MP4")] = None,
    set_: Overrides = (),
) -> None:
    """Look into a run with a browser: room, beam, images, volume, errors; also while it goes on.

    Of a scenario that was not run: room, plan, reach of the path and field of view.

    Args:
        export: Write a page that needs no server instead: it plays all views, with a free camera.
        movie: Write a film of the scan instead.
    """
    view_command(targets, host, port, allow_network, export, movie, set_)


@app.command
def render(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("room.png"),
    view: Annotated[int, tyro.conf.arg(help_behavior_hint="(default: the middle one)")] = MIDDLE,
    width: int = 1600,
    height: int = 1000,
    set_: Overrides = (),
) -> None:
    """Picture of the operating room at one view.

    A view that cannot be had is drawn all the same: what collides in red, source or panel as a
    ghost where it shall be, its arm in the nearest configuration.

    Args:
        out: File to write.
        view: Which view source and panel shall be at.
        width: Width of the picture in pixels.
        height: Height of the picture in pixels.
    """
    from twinct.cell import check_drawing, check_picture_size
    from twinct.cli.reach import draw_anyway
    from twinct.errors import InputError
    from twinct.extras import require
    from twinct.files.writing import check_picture, storage_errors
    from twinct.scan import Workshop

    loaded = load_scenario(scenario, set_)
    check_picture(out)
    check_picture_size(width, height)
    require("robots")
    check_drawing()
    workshop = Workshop(loaded)
    views = len(workshop.asked)  # commanded ones need a plan, which there may not be
    view = views // 2 if view == MIDDLE else view
    if not 0 <= view < views:
        raise InputError(f"--view {view}: the scenario has views 0 to {views - 1}")
    with named_places(scenario, set_), storage_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        for problem in draw_anyway(workshop, out, view, width, height):
            say(problem, warning=True)
    Console().print(f"wrote {out}", highlight=False)


@app.command
def reach(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    radii: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MM")] = (),
    odd: Annotated[float | None, tyro.conf.arg(metavar="MM")] = None,
    directions: int = 1000,
    connected: Flag = False,
    set_: Overrides = (),
) -> None:
    """Where source and panel can go: directions all over the sphere, at one radius or several.

    Source and panel may be turned about the beam.

    Args:
        out: Folder for reach.json, reach.csv, and pictures of the sphere and of the room.
        radii: Distances from the isocentre to the source (default: the scenario's).
        odd: Distance from the isocentre to the panel (default: the scenario's).
        directions: How many.
        connected: Also seek collision-free ways between them, which takes minutes.
    """
    from twinct.cli.reach import reach_command

    reach_command(scenario, set_, out, radii, odd, directions, connected)


@app.command
def plan(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    scout: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None,
    try_views: Annotated[Flag, tyro.conf.arg(name="try")] = False,
    address: Annotated[str | None, tyro.conf.arg(metavar="auto|local|HOST:PORT")] = None,
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    resume: Flag = False,
    threads: Threads = None,
    set_: Overrides = (),
) -> None:
    """Choose views for the section task of a scenario, among those that the arms can have.

    Writes views.csv, planned.yaml, which twinct run executes, plan.npz, plan.json and plan.png.

    Args:
        out: Folder for the results.
        scout: Run of a few views, by which the specimen is put where it lies before planning.
        try_views: Make images of the planned views and of the scenario's path, and compare the
            volumes: tried.png.
        address: Where Ray answers; local starts one on this machine. Default: local processes.
        jobs: Processes that look for what the arms reach and judge paths of a family (default: as
            many as there are threads).
        resume: Go on with a search that was interrupted.
    """
    from twinct.cli.plan import plan_command

    plan_command(scenario, set_, out, scout, try_views, address, jobs, resume, threads)


@app.command
def uncertainty(
    scenario: ScenarioFile,
    *,
    draws: int = 1000,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    picture: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("view.png"),
    set_: Overrides = (),
) -> None:
    """What the errors of a scenario do to its geometry: poses, images, causes; nothing is rendered.

    Args:
        draws: How many scans are drawn.
        out: Folder for uncertainty.json, with all covariances, and uncertainty.png.
        picture: File for the picture of a view that cannot be had.
    """
    from twinct.cli.uncertainty import uncertainty_command

    uncertainty_command(scenario, set_, draws, out, picture)


@app.command
def place(
    scenario: ScenarioFile,
    *,
    sphere: Flag = False,
    save: Annotated[Path | None, tyro.conf.arg(metavar="YAML")] = None,
    x: tuple[float, float] = (-1000.0, 1000.0),
    y: tuple[float, float] = (-1000.0, 1000.0),
    z: tuple[float, float] = (-800.0, 400.0),
    standoff: tuple[float, float] = (100.0, 300.0),
    tool_rotation: tuple[float, float] = (-180.0, 180.0),
    samples: int = 128,
    seed: int = 0,
    set_: Overrides = (),
) -> None:
    """Where the arms had better stand for a scenario's trajectory, or for most of the sphere.

    Args:
        sphere: Serve as many directions as can be, source and panel turned about the beam.
        save: Write a scenario with the keys that were found.
        x: Lowest and highest position of a base, mm.
        y: Lowest and highest position of a base, mm.
        z: Lowest and highest position of a base, mm.
        standoff: From flange to focal spot and panel centre, mm.
        tool_rotation: Turn of the tools about the flange axis, deg.
        samples: Places of each arm alone that are looked at first.
        seed: Of the search.
    """
    from twinct.cli.reach import place_command
    from twinct.reach import Bounds

    place_command(
        scenario, set_, sphere, save, Bounds(x, y, z, standoff, tool_rotation), samples, seed
    )


@app.command
def node(
    which: Annotated[
        tyro.conf.Positional[Literal["robots", "xray"]], tyro.conf.arg(metavar="{robots,xray}")
    ],
    scenario: ScenarioFile,
    *,
    set_: Overrides = (),
) -> None:
    """Start one simulation as a ROS 2 node of its own, until it is interrupted.

    The robots node takes targets on /scan/target and answers on /scan/reached; the xray node takes
    /scan/reached and answers on /xray/image.

    Args:
        which: The robot simulation or the X-ray simulation.
    """
    from twinct.extras import require
    from twinct.ros import spin_robots, spin_xray
    from twinct.runs import check_physics
    from twinct.scan import Workshop

    loaded = load_scenario(scenario, set_)
    if which == "xray" or loaded.cell.kind == "arms":
        require("robots" if which == "robots" else "xray")
    with named_places(scenario, set_):
        if which == "xray":
            check_physics(Workshop(loaded))
        code = spin_robots(loaded) if which == "robots" else spin_xray(loaded)
    if code:
        sys.exit(code)


@app.command
def urdf(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    set_: Overrides = (),
) -> None:
    """Robot description of the operating room, for ROS 2 and whatever reads URDF.

    Args:
        out: Folder for cell.urdf and its meshes.
    """
    from twinct.extras import require
    from twinct.files.writing import check_folder, storage_errors, write_text
    from twinct.scan import Workshop

    loaded = load_scenario(scenario, set_)
    check_folder(out)
    require("robots")
    file = out / "cell.urdf"
    with named_places(scenario, set_), storage_errors(out):
        write_text(file, Workshop(loaded).urdf(meshes=out))
    Console().print(f"wrote {file}", highlight=False)


@app.command
def schema() -> None:
    """Print the JSON Schema of the scenario file, for editors."""
    sys.stdout.write(json.dumps(scenario_schema(), indent=2) + "\n")


@app.command
def specimen(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    set_: Overrides = (),
) -> None:
    """Build the specimen only: a mesh for each part, the voxel truth and a picture.

    Args:
        out: Folder for PART.stl, truth.nii and specimen.png.
    """
    from twinct.files.writing import check_folder, storage_errors
    from twinct.scan import Workshop
    from twinct.specimen.preview import preview_specimen
    from twinct.volume import Volume
    from twinct.xray.build import effective_energy_kev

    loaded = load_scenario(scenario, set_)
    check_folder(out)
    with named_places(scenario, set_):
        energy = effective_energy_kev(loaded.source, loaded.detector)
        built = Workshop(loaded).specimen
    grid = loaded.reconstruction.volume_grid
    table = Table("part", "material", f"mu at {energy:g} keV, 1/mm", "triangles", "volume, cm3")
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        for index, part in enumerate(built.parts):
            part.mesh.export(out / f"{index}-{part.name}.stl")
            material, mesh = part.material, part.mesh
            figures = f"{material.mu_per_mm(energy):.5f}", f"{len(mesh.faces)}"
            table.add_row(part.name, material.name, *figures, f"{mesh.volume / 1000:.1f}")
        preview_specimen(built, out / "specimen.png", title=loaded.name)
        Volume(built.truth(grid, energy), grid).write(out / "truth.nii", "twinct truth, 1/mm")
    Console().print(table)


@app.command
def export(
    scan: Annotated[
        tyro.conf.Positional[Path],
        tyro.conf.arg(metavar="SCAN", help="What twinct run --out wrote, or the scan.zarr in it."),
    ],
    *,
    to: Literal["rtk", "astra", "leap", "cil", "tigre", "openct"],
    geometry: Annotated[str, tyro.conf.arg(metavar="NAME")] = "believed",
    values: Literal["line-integrals", "transmission"] = "line-integrals",
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> None:
    """Write a scan so that another toolkit reconstructs it as it is.

    DIR gets the projections, the geometry, the voxel grid of the scenario, a script load.py that
    loads them into the toolkit and reconstructs, and a README. A scan under way is written as far
    as it is.

    Args:
        to: The toolkit, or openct for programs that read an OpenCT free trajectory.
        geometry: believed (what the system reports), executed (where the arms really were),
            commanded (what was asked of them), or one that twinct geometry has made.
        values: Pixels as -ln(I/I0), or as I/I0.
        out: Folder to write, which must not exist; export-TOOLKIT beside the scan unless given.
    """
    from twinct.cli.export import export_scan

    export_scan(scan, to, geometry, values, out)


@app.command(name="import")
def import_(
    files: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="FILE", help="What run --record wrote, or another tool's MCAP file."),
    ],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
) -> None:
    """Rebuild a scan from recordings of it: DIR/scan.zarr and DIR/scenario.yaml.

    Several files are those of a scan that was interrupted and resumed. Views that they miss are
    named; run --resume takes them. Of another tool's recording of the same topics poses, cameras
    and images are taken, as a gantry's scan of an unknown specimen.

    Args:
        out: Folder to write, without a run in it.
    """
    from twinct.runs import import_scan

    found = import_scan(files, out)
    for problem in found.contents.problems:
        say(problem, warning=True)
    if found.missing:
        say(f"missing: {found.missing_in_words}", warning=True)
    count = len(found.views)
    say(f"{count} of {count + len(found.missing)} views imported to {out}")


@app.command
def report(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    set_: Overrides = (),
) -> None:
    """Judge a finished run again and rewrite its metrics.json and report.html.

    ``--set evaluation.KEY=VALUE`` measures other things in its volumes; none is made anew.

    Args:
        folder: What ``twinct run --out`` wrote.
    """
    from twinct.runs import report_again

    with named_places(folder / "scenario.yaml", set_), on_terminal() as audience:
        again = report_again(folder, audience, set_)
    _say_result(again)


@app.command
def compare(
    folders: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DIR")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="HTML")] = Path("compare.html"),
) -> None:
    """Compare finished runs on one page: slices, figures, pose errors, times, and their scenarios.

    Slices are at the same places in the same windows; differences are against the first run.

    Args:
        folders: What ``twinct run --out`` wrote, or DIR/reconstructions/NAME for what ``twinct
            reconstruct`` made beside it; two or more.
        out: File to write.
    """
    from twinct.files.writing import check_page, storage_errors
    from twinct.runs import compare

    check_page(out)
    with on_terminal() as audience:
        comparison = compare(folders, audience)
    for note in comparison.notes:
        say(note, warning=True)
    with storage_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        comparison.write(out)
    say(f"wrote {out}: {len(comparison.keys)} scenario keys differ")


@app.command
def verify(folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]) -> None:
    """Compare each file of a scan with the digest that was kept of it, and look at its results.

    Ends with 1 where anything is damaged, missing or not finished; what is damaged of a scan
    'twinct run --resume' takes again.

    Args:
        folder: What ``twinct run --out`` wrote, or the scan.zarr in it.
    """
    from twinct.runs import verify

    found = verify(folder)
    for problem in found.problems:
        say(problem, warning=True)
    for file in found.unknown:
        say(f"{file}: unknown, left alone")
    told = f"{len(found.problems)} problems" if found.problems else "whole"
    say(f"{folder}: {told} ({found.in_words})")
    if found.problems:
        sys.exit(1)


@app.command
def reconstruct(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    geometry: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    as_: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None,
    threads: Threads = None,
    set_: Overrides = (),
) -> None:
    """Reconstruct a finished run once more, beside what there is, and show both in its report.

    Args:
        folder: What ``twinct run --out`` wrote.
        geometry: commanded, executed, believed, or one that twinct geometry has made.
        as_: Name of the result, below DIR/reconstructions; after its algorithm where left out.
    """
    from twinct.runs import reconstruct_again
    from twinct.threads import limit_threads

    limit_threads(threads)
    with on_terminal() as audience:
        made = reconstruct_again(folder, set_, geometry=geometry, name=as_, observers=audience)
    rmse, near = (_percent(x) for x in (made.figures.rmse_rel, made.figures.rmse_bone_rel))
    say(
        f"{made.name}: {made.in_words}, {made.geometry} geometry; RMSE {rmse}, {near} near "
        f"the reference material\n{made.path}; report: {folder / 'report.html'}"
    )


@app.command
def geometry(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    as_: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None,
    set_: Overrides = (),
) -> None:
    """List the geometries of a scan, or derive one more: what its robots would report.

    Args:
        folder: What ``twinct run --out`` wrote.
        as_: Name of the new geometry; without it those that there are are listed.
        set_: Keys of uncertainty, such as --set uncertainty.seed=3.
    """
    from twinct.errors import InputError
    from twinct.evaluate import pose_errors
    from twinct.runs import derive_geometry, load_scan
    from twinct.scan import OWN

    if as_ is not None:
        with on_terminal() as audience:
            derive_geometry(folder, as_, set_, audience)
    elif set_:
        raise InputError(f"--set {set_[0]}: a new geometry needs a name (--as)")
    scan = load_scan(folder)
    table = Table("geometry", "source to executed, mm", "detector to executed, mm", "made by")
    for name in (*OWN, *(n for n in scan.derived if n not in OWN)):
        errors = pose_errors(scan.executed, scan.poses(name))
        means = (f"{arm.position_mm.mean():.4f}" for arm in (errors.source, errors.detector))
        made_by = scan.derived[name].made_by if name in scan.derived else {}
        words = ", ".join(f"{k} {v}" for k, v in made_by.items() if not isinstance(v, dict))
        table.add_row(name, *means, words)
    Console().print(table)


@app.command
def calibrate(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    with_: Annotated[
        Literal["beads", "balls", "kinematics", "self"], tyro.conf.arg(name="with")
    ] = "beads",
    as_: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None,
    to: Annotated[Sequence[Path], tyro.conf.arg(metavar="DIR")] = (),
    from_: Annotated[Path | None, tyro.conf.arg(name="from", metavar="FILE")] = None,
    sigma_mm: float = 0.5,
    sigma_deg: float = 0.2,
    correlation_views: float = 0.0,
    what: Literal["arms", "patient"] = "arms",
    start: Literal["believed", "epipolar"] = "believed",
    align: Flag = False,
    ball_radius_mm: float = 1.5,
) -> None:
    """Find where source and detector really were, and add that to a scan as a geometry.

    ``twinct reconstruct DIR --geometry NAME`` reconstructs from it.

    Args:
        folder: What ``twinct run --out`` wrote; for beads and kinematics of a specimen with a
            ball_helix.
        with_: beads: the balls of a phantom, whose places are known; balls: a few balls at unknown
            places on the specimen; kinematics: both arms, from all views of a phantom, kept in
            DIR/arms.json; self: the projections alone, each view moved until they agree.
        as_: Name of the new geometry; that of the method unless given.
        to: Folders of scans that get the geometry, too: of the same views (beads), or of the same
            arms along any trajectory (kinematics).
        from_: An arms.json; the scan then need not be of balls (kinematics).
        sigma_mm: What source and panel, or the patient, are off along each axis, as far as is
            known (self, balls).
        sigma_deg: The same of the rotation of panel or patient about each axis (self, balls).
        correlation_views: Over how many views errors are alike; 0: each view's own (self, balls).
        what: What may have moved: source and panel, or the patient between them (self).
        start: What to go on from; epipolar: each view is first moved until it tells the same as
            others of planes through both sources, without a volume (self).
        align: Keep what was found moved as a whole to where the executed geometry lies, for figures
            that compare volumes (self, balls).
        ball_radius_mm: Of each ball (balls).
    """
    from twinct.calibration import PosePrior
    from twinct.cli.calibrate import (
        balls_command,
        beads_command,
        kinematics_command,
        self_command,
    )
    from twinct.errors import InputError

    if from_ is not None and with_ != "kinematics":
        raise InputError(f"--from {from_}: arms are of --with kinematics")
    if start != "believed" and with_ != "self":
        raise InputError(f"--start {start}: only --with self goes on from a start")
    if with_ == "kinematics":
        kinematics_command(folder, as_, to, from_)
    elif with_ == "beads":
        beads_command(folder, as_, to)
    else:
        if to:
            raise InputError(f"--to {to[0]}: what a scan finds of itself is of no other one")
        prior = PosePrior(sigma_mm, sigma_deg, correlation_views)
        if with_ == "self":
            self_command(folder, as_, prior, what, start, align=align)
        elif what == "patient":
            raise InputError("--what patient: with balls, source and panel are what may have moved")
        else:
            balls_command(folder, as_, ball_radius_mm, prior, align=align)


def _say_result(run: Run) -> None:
    """The main figures in two lines."""
    image, pose = run.figures["image"], run.figures["pose_error"]
    material = run.figures.get("reference_material", "bone")  # older runs do not say
    say(
        f"{run.figures['reached']} of {run.figures['views']} views; "
        f"RMSE {_percent(image['rmse_rel'])} of mu({material}), "
        f"{_percent(image['rmse_bone_rel'])} near {material}; "
        f"pose error {pose['source']['position_mm']['mean']:.2f} mm source, "
        f"{pose['detector']['position_mm']['mean']:.2f} mm detector\n"
        f"report: {run.paths.report}"
    )


def _percent(share: float | None) -> str:
    """None stands for a figure without a voxel to stand on, such as near bone where is none."""
    return "no figure" if share is None else f"{100 * share:.1f} %"


app.command(study)
app.command(ctsimu, name="ctsimu", help="Scenarios of the CTSimU format: render, export, qualify.")
