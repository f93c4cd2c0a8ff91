"""Commands on a scenario file that do not run it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.table import Column, Table

from twinct.cli.arguments import Flag, Json, Overrides, ScenarioFile, Threads
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal, say, warnings_into
from twinct.cli.time_limit import limited
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.threads import limit_threads

if TYPE_CHECKING:
    from twinct.scan import SimulationBuilder
    from twinct.scenario import Scenario


def check(
    scenario: ScenarioFile,
    *,
    save: Annotated[Path | None, tyro.conf.arg(metavar="NPZ")] = None,
    picture: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("view.png"),
    no_cures: Flag = False,
    all_cures: Flag = False,
    time_limit: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    threads: Threads = None,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Validate a scenario, build its specimen, plan its motion and rehearse it, without running it.

    The rehearsal simulates the arms' motion without images, and finds every view that a run would
    miss. The command lists every view that an arm cannot reach or that would collide, suggests a
    remedy, and draws the first of these views.

    Args:
        save: File for the plan; a scenario follows it with the key motion.plan.
        picture: File for the picture of an infeasible view.
        no_cures: Report infeasible views without a remedy and a picture.
        all_cures: Try all changes that may help, even if that takes longer than planning.
        time_limit: Longest time that the check may take; then it ends with the problems found.
    """
    limit_threads(threads)
    with answering(as_json) as answer, limited(time_limit, "--time-limit"):
        answer |= {"scenario": str(scenario), "can_be_run": False, "warnings": []}
        with warnings_into(answer["warnings"]):
            _check(scenario, save, None if no_cures else picture, all_cures, set_, answer)


def _check(
    scenario: Path,
    save: Path | None,
    picture: Path | None,
    all_cures: bool,
    set_: Overrides,
    answer: dict[str, Any],
) -> None:
    """Check a scenario; without a path for a picture, no remedy is sought."""
    from twinct.scenario import load_scenario, named_places

    loaded = load_scenario(scenario, set_)
    if save is not None:
        _check_plan_file(loaded, save)
    from twinct.runs import (  # a mistake in the scenario is reported without loading these
        check_geometries,
        check_physics,
        check_sight,
        findings,
        rehearse,
        require_extras,
        require_feasible,
        require_memory,
    )
    from twinct.scan import SimulationBuilder

    with named_places(scenario, set_):
        require_extras(loaded)
    builder = SimulationBuilder(loaded)
    remedy = _remedy(builder, picture, all_cures)
    with named_places(scenario, set_):
        require_memory(loaded)
        check_geometries(loaded)
        if builder.plan_chooses:  # otherwise, the views are known without a plan
            with remedy():
                _planned(builder)
        check_physics(builder)
        require_feasible(loaded, builder.commanded)
        for warning in check_sight(builder):
            say(warning, warning=True)
            answer["warnings"].append(warning)
        with remedy():
            _planned(builder)
        with on_terminal() as audience:
            rehearse(builder, audience)
        facts = {name: words.replace("×", "x") for name, words in findings(builder).items()}
        doubt = ", with the warnings above" if answer["warnings"] else ""
        table = _findings_table(f"{loaded.name}: can be run{doubt}", facts)
        if save is not None:
            from twinct.robots.motion import save_plan

            assert builder.followed is not None  # as _check_plan_file has found
            save_plan(builder.followed, save)
    answer |= {"can_be_run": True, "findings": facts}
    Console().print(table)


def _findings_table(title: str, facts: dict[str, str]) -> Table:
    """Return the findings; long words, such as a digest, go on in the next line."""
    table = Table("", Column(overflow="fold"), title=title, show_header=False)
    for name, words in facts.items():
        table.add_row(name, words)
    return table


def _remedy(
    builder: SimulationBuilder, picture: Path | None, all_cures: bool
) -> Callable[[], AbstractContextManager[None]]:
    """Return contexts that search for a remedy of a refused plan."""
    if builder.scenario.cell.kind != "arms" or picture is None:  # a gantry needs no MuJoCo
        return nullcontext
    from twinct.cli.reach import explained

    return partial(explained, builder, picture, all_cures=all_cures)


def _planned(builder: SimulationBuilder) -> None:
    """Plan the motion, with a stage on the terminal."""
    if builder.scenario.cell.kind == "arms":
        with on_terminal() as audience, audience.stage("planning the motion", 1) as step:
            _ = builder.plan
            step()


def _check_plan_file(scenario: Scenario, path: Path) -> None:
    """Check that a scenario has a plan, and that a path can become its file."""
    from twinct.core.files.writing import check_plan_file

    if scenario.cell.kind != "arms" or scenario.motion.scheme == "reactive":
        why = "motion.scheme: reactive" if scenario.cell.kind == "arms" else "a gantry"
        raise InputError(f"--save {path}: {why} has no motion plan")
    check_plan_file(path)


def render(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("room.png"),
    view: Annotated[
        int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="(default: the middle one)")
    ] = None,
    width: int = 1600,
    height: int = 1000,
    set_: Overrides = (),
) -> None:
    """Draw the operating room at one view.

    An infeasible view is drawn, too: collisions in red, a source or panel out of reach as a ghost
    at its target, and its arm in the nearest configuration.

    Args:
        out: File to write.
        view: View at which source and panel are drawn.
        width: Width of the picture in pixels.
        height: Height of the picture in pixels.
    """
    from twinct.cli.reach import draw_anyway
    from twinct.core.files.writing import check_picture, storage_errors
    from twinct.robots.cell import check_drawing, check_picture_size
    from twinct.scan import SimulationBuilder
    from twinct.scenario import load_scenario, named_places

    loaded = load_scenario(scenario, set_)
    check_picture(out)
    check_picture_size(width, height)
    require("robots")
    check_drawing()
    builder = SimulationBuilder(loaded)
    views = len(builder.requested)  # commanded views need a plan, which may not exist
    view = views // 2 if view is None else view
    if not 0 <= view < views:
        raise InputError(f"--view {view}: the scenario has views 0 to {views - 1}")
    with named_places(scenario, set_), storage_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        for problem in draw_anyway(builder, out, view, width, height):
            say(problem, warning=True)
    Console().print(f"wrote {out}", highlight=False)


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
    from twinct.core.files.writing import check_folder, complete, storage_errors
    from twinct.recon.volume import Volume
    from twinct.scan import SimulationBuilder
    from twinct.scenario import load_scenario, named_places
    from twinct.specimen.preview import preview_specimen
    from twinct.xray.build import effective_energy_kev

    loaded = load_scenario(scenario, set_)
    check_folder(out)
    with named_places(scenario, set_):
        energy = effective_energy_kev(loaded.source, loaded.detector)
        built = SimulationBuilder(loaded).specimen
    grid = loaded.reconstruction.volume_grid
    table = Table("part", "material", f"mu at {energy:g} keV, 1/mm", "triangles", "volume, cm3")
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        for index, part in enumerate(built.parts):
            with complete(out / f"{index}-{part.name}.stl") as draft:
                part.mesh.export(draft)
            figures = (
                f"{part.mean_mu(energy):.5f}",
                f"{len(part.mesh.faces)}",
                f"{part.volume_mm3 / 1000:.1f}",
            )
            table.add_row(part.name, part.in_words, *figures)
        preview_specimen(built, out / "specimen.png", title=loaded.name)
        Volume(built.truth(grid, energy), grid).write(out / "truth.nii", "twinct truth, 1/mm")
    Console().print(table)


def urdf(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    moveit: Flag = False,
    set_: Overrides = (),
) -> None:
    """Write a robot description of the operating room, for ROS 2 and other readers of URDF.

    Args:
        out: Folder for cell.urdf and its meshes.
        moveit: Write the arms (arms.urdf, arms.srdf, joint_limits.yaml) and the room with its
            forbidden zones (room.scene) for MoveIt instead. We have not tried them in MoveIt yet.
    """
    from twinct.core.files.writing import check_folder, storage_errors, write_text
    from twinct.scan import SimulationBuilder
    from twinct.scenario import load_scenario, named_places

    loaded = load_scenario(scenario, set_)
    check_folder(out)
    require("robots")
    builder = SimulationBuilder(loaded)
    with named_places(scenario, set_), storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        files = builder.moveit(out) if moveit else {"cell.urdf": builder.urdf(meshes=out)}
        for name, text in files.items():
            write_text(out / name, text)
    paths = ", ".join(str(out / name) for name in files)
    Console().print(f"wrote {paths}", highlight=False)


def init(
    file: Annotated[
        tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE", help="Scenario file to write.")
    ] = Path("scenario.yaml"),
    *,
    from_: Annotated[str, tyro.conf.arg(name="from", metavar="NAME")] = "demo",
) -> None:
    """Write a scenario to start from, with a comment on each key.

    Args:
        from_: Built-in scenario to copy, such as circle_gantry, head or patient_spine.
    """
    from twinct.core.files.writing import storage_errors, write_text
    from twinct.scenario.commented import commented_scenario

    if file.suffix not in (".yaml", ".yml"):
        raise InputError(f"{file}: a scenario file must end in .yaml")
    if file.exists():
        raise InputError(f"{file} exists already; choose another name, or remove it")
    text = commented_scenario(from_, str(file))
    with storage_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, text)
    say(f"wrote {file}; 'twinct check {file}' says whether it can be run")


def schema() -> None:
    """Print the JSON Schema of the scenario file, for editors."""
    from twinct.scenario import scenario_schema

    sys.stdout.write(json.dumps(scenario_schema(), indent=2) + "\n")
