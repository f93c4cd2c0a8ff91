"""Figures and report of a run, written into its folder."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.arguments import kinds_checked
from twinct.core.errors import DrawingError, MissingExtraError
from twinct.core.files.private import temporary_folder
from twinct.core.files.writing import write_json
from twinct.evaluation import (
    Again,
    ImageFigures,
    pose_errors,
    reprojection_px,
    rmse_by_depth,
    tool_speeds,
)
from twinct.geometry.wire import PosePairs
from twinct.recon.volume import Volume
from twinct.report import (
    STAGES,
    Another,
    CrossSection,
    ReportData,
    algorithm_results,
    build_metrics,
    cross_sections,
    draw_pictures,
    plain,
    write_report,
)
from twinct.robots.cell import check_drawing
from twinct.runs.folder import Folder, as_yaml
from twinct.runs.known_motion import as_reconstructed, motion_in_words, moving_figures
from twinct.runs.predicted_and_measured import (
    drive_times,
    planned_detectability,
    stored_predictions,
)
from twinct.runs.reconstruction_folder import StoredReconstruction, stored_reconstructions
from twinct.runs.regions import Places
from twinct.runs.seconds import Seconds, Timing
from twinct.runs.stages import figures_digest
from twinct.runs.truth import Truth, truth_of
from twinct.scan import Scan, ScanStore, SimulationBuilder
from twinct.scenario import stage_digests
from twinct.specimen import BuiltSpecimen, build_specimen

log = logging.getLogger(__name__)

_SHOWN_VIEWS = 4
"""Number of projections in the report."""


def judge(
    scan: Scan,
    volume: Volume,
    truth: Truth,
    specimen: BuiltSpecimen | None = None,
    again: Again | None = None,
) -> ImageFigures:
    """Compute the image figures of a reconstruction, with the section ``evaluation``.

    The section refers to parts of the specimen, which is built if it is needed and not given.
    Figures that need repetitions of the scan are NaN without ``again``, see ``Repeats``.
    """
    scenario, array = scan.scenario, volume.array
    grid, mu = truth.grid, truth.mu_reference
    volume.require_grid(grid)
    figures = truth.reference.figures(array)
    further: dict[str, Any] = {
        "edge_width_mm": truth.edges.width(array),
        "rmse_rel_by_depth": rmse_by_depth(array, truth.volume, truth.region, truth.depth, mu),
    }
    further |= moving_figures(scan, array, truth.volume, truth.region, mu, grid)
    if scenario.evaluation is not None:
        built = as_reconstructed(specimen or build_specimen(scenario.specimen), scenario)
        further |= Places(scenario, built, scan.stands, grid).figures(
            array,
            truth.volume,
            mu,
            figures.signal_rel,
            truth.mu_water,
            again,
            figures.signal_error_rel,
        )
    return replace(figures, further=further).honest()


@kinds_checked
def evaluate(scan: Scan, volume: Volume, truth: Truth | None = None) -> ImageFigures:
    """Compute the figures of merit of a volume against the true specimen of its scan.

    Args:
        scan: projections, executed poses and scenario.
        volume: a reconstruction, 1/mm, on any grid.
        truth: the truth on the volume's grid, if it was computed before (``truth_of``).

    Returns:
        The figures; ``as_dict()`` has those that ``metrics.json`` lists, also those that the
        scenario's section ``evaluation`` requests. Detectability is NaN: the way from the scan to
        the volume is unknown here.

    Raises:
        InputError: volume and truth have different grids.
    """
    builder = SimulationBuilder(scan.scenario)
    truth = truth or truth_of(scan, builder, grid=volume.grid)
    return judge(scan, volume, truth, builder.specimen if scan.scenario.evaluation else None)


@dataclass(frozen=True, eq=False)
class Results:
    """Results of a run, except its scan.

    Attributes:
        slices: cross-sections of the reconstruction that is stored, and of its truth.
        mu_reference: attenuation to which figures are relative, 1/mm.
        extras: further results of the algorithm.
        figures: figures of the reconstruction from each geometry.
        residuals: residual of each iteration, by geometry.
    """

    slices: Mapping[str, CrossSection]
    mu_reference: float
    extras: Mapping[str, Any]
    figures: Mapping[str, ImageFigures]
    residuals: Mapping[str, list[float]]

    @classmethod
    def of(cls, volume: Volume, truth: Truth) -> Results:
        """Return the results of a volume, to which figures and residuals are added."""
        slices = cross_sections(volume.array, truth.volume, truth.region, truth.grid)
        return cls(slices, truth.mu_reference, volume.extras, {}, {})


def write_results(
    folder: Folder,
    builder: SimulationBuilder,
    scan: Scan,
    results: Results,
    timing: Seconds | Timing,
) -> None:
    """Write report.html and metrics.json, each completely or not at all.

    The timing is a running ``Seconds``, or the ``Timing`` of a run that is reported again.
    """
    scenario, others = builder.scenario, stored_reconstructions(folder.reconstructions)
    with timing.stage("report") if isinstance(timing, Seconds) else nullcontext():
        data = replace(
            _report_data(scan, builder, results),
            others=_others(others.values()),
            predictions=stored_predictions(folder.predictions),
        )
        pictures = draw_pictures(data)
    if isinstance(timing, Seconds):
        timing = timing.finished()
    digests = stage_digests(scenario)
    metrics = build_metrics(
        **_of_scan(scan),
        **algorithm_results(results.extras),
        image=results.figures,
        seconds=timing.stages,
        real_time_factor=timing.real_time_factor,
        scenario_digest=digests["images"],
        reconstruction_digest=folder.volume_digest(scenario),
        figures_digest=figures_digest(scenario),
        residuals=results.residuals,
        reconstructions={
            other.name: {
                "in_words": other.in_words,
                "geometry": other.geometry,
                "digest": other.digest,
                "image": other.figures.as_dict(),
                "seconds": other.seconds,
                **other.results,
            }
            for other in others.values()
        },
        geometries=_geometries(scan),
        reference_material=builder.specimen.reference_name,
        files=folder.file_digests(),
        **_sweeps(folder),
        **drive_times(folder.drive),
        **planned_detectability(scenario, next(iter(results.figures.values())).as_dict()),
    )
    write_report(folder.report, replace(data, metrics=metrics), pictures)
    write_json(folder.metrics, metrics)


def _sweeps(folder: Folder) -> dict[str, Any]:
    """Return the comparisons of a scan in sweeps, and how many views it might have taken."""
    store = ScanStore(folder.scan)
    if store.sweeps.complete is None:
        return {}
    return {
        "planned_views": store.planned_views,
        "changes_rel": store.sweeps.as_dict()["changes_rel"],
    }


def write_volumes(folder: Folder, scan: Scan) -> None:
    """Write report.html and metrics.json of a scan without a truth, hence without a run."""
    volumes, panel = stored_reconstructions(folder.reconstructions), scan.settings.detector.panel
    metrics = plain(
        {
            "views": len(scan),
            "truth": None,
            "reconstructions": {
                one.name: {
                    "in_words": one.description,
                    "geometry": one.geometry,
                    "digest": one.digest,
                    "seconds": one.seconds,
                    "judgement": one.figures.as_dict(),
                }
                for one in volumes.values()
            },
        }
    )
    data = ReportData(
        scenario=scan.settings,
        scenario_yaml=as_yaml(scan.settings),
        metrics=metrics,
        panel=panel,
        stated=scan.believed,
        projections=_shown(scan),
        others=_others(volumes.values()),
        predictions=stored_predictions(folder.predictions),
    )
    write_report(folder.report, data)
    write_json(folder.metrics, metrics)


def _shown(scan: Scan) -> list[tuple[int, NDArray[np.float32]]]:
    """Return a few views and their images."""
    views = np.unique(np.linspace(0, len(scan) - 1, _SHOWN_VIEWS).round().astype(int))
    return [(int(view), scan.transmission[view]) for view in views]


def figures_of(scan: Scan, image: Mapping[str, ImageFigures]) -> dict[str, Any]:
    """Return the part of ``metrics.json`` that depends on a scan and its image figures only."""
    nothing = {stage: 0.0 for stage in STAGES}
    whole = build_metrics(**_of_scan(scan), image=image, seconds=nothing, scenario_digest="")
    others = "seconds", "real_time_factor", "scenario_digest", "twinct_version"
    figures = {name: value for name, value in whole.items() if name not in others}
    return figures | {"geometries": plain(_geometries(scan))}


def _of_scan(scan: Scan) -> dict[str, Any]:
    moved = len(scan) > 1 and scan.scenario.cell.kind == "arms"
    return {
        "views": len(scan.commanded),
        "reached": len(scan),
        "pose_errors": pose_errors(scan.commanded, scan.executed),
        "clearance_mm": scan.clearance_mm,
        "simulated_seconds": float(scan.simulated_s[-1]),
        "told_error": pose_errors(scan.commanded, scan.simulated.nominal).summary()
        if scan.scenario.uncertainty.moves
        else {},
        "tool_speed_mm_s": tool_speeds(scan.executed, scan.simulated_s) if moved else {},
    }


def _geometries(scan: Scan) -> dict[str, Any]:
    """Return origin, digest and errors of the believed and each derived geometry."""
    return {
        poses.name: {
            "made_by": dict(poses.made_by),
            "digest": poses.digest,
            "pose_error": pose_errors(scan.executed, poses.poses).summary(),
            "reprojection_px": _reprojection(scan, poses.poses),
        }
        for poses in {"believed": scan.reported, **scan.derived}.values()
    }


def _reprojection(scan: Scan, taken: PosePairs) -> dict[str, float]:
    """Return mean and maximum reprojection error of the isocentre, seen from the specimen, px."""
    panel, trajectory = scan.scenario.detector.panel, scan.scenario.trajectory
    # A file of views has no isocentre: use the world's origin.
    isocentre = np.array([getattr(trajectory, "isocentre_mm", (0.0, 0.0, 0.0))])
    off = reprojection_px(scan.relative.geometry(panel), taken.geometry(panel), isocentre)
    return {name: float(of(off)) for name, of in (("mean", np.mean), ("max", np.max))}


def _others(reconstructions: Iterable[StoredReconstruction]) -> list[Another]:
    return [
        Another(
            one.name,
            f"{one.description}, {one.geometry} geometry",
            plain(one.figures.as_dict()),
            one.residuals,
            one.slices or _without_truth(one.volume),
            one.seconds,
        )
        for one in reconstructions
    ]


def _without_truth(volume: Volume) -> dict[str, CrossSection]:
    """Return cross-sections of a volume whose folder has none, as of an earlier version."""
    return cross_sections(volume.array, None, np.ones(volume.shape, bool), volume.grid)


def _report_data(scan: Scan, builder: SimulationBuilder, results: Results) -> ReportData:
    """Return the content of a report; of the figures, only the residuals."""
    scenario, plan = builder.scenario, builder.plan
    return ReportData(
        scenario=scenario,
        scenario_yaml=as_yaml(scenario),
        metrics={"residuals": dict(results.residuals)},
        commanded=scan.commanded,
        executed=scan.executed,
        panel=scenario.detector.panel,
        clearance_mm=scan.clearance_mm,
        projections=_shown(scan),
        slices=results.slices,
        mu_reference=results.mu_reference,
        reference=builder.specimen.reference_name,
        room_png=_room(builder),
        nearest=plan.nearest[int(plan.clearance_mm.argmin())] if plan else (),
        mas=scan.mas,
        motion=motion_in_words(scenario, scan.middle_s) if scenario.specimen.motion else "",
    )


def _room(builder: SimulationBuilder) -> bytes | None:
    """Draw the room at the middle of the path; return None if that cannot be done here."""
    try:
        check_drawing()
    except DrawingError:  # see ``tell_if_undrawable``
        return None
    with temporary_folder() as folder:
        path = folder / "room.png"
        try:
            builder.draw(path, len(builder.targets) // 2)
        except (MissingExtraError, DrawingError) as error:
            log.warning("no picture of the room: %s", error)
            return None
        return path.read_bytes()
