"""Main figures of a run, in words."""

from __future__ import annotations

from twinct.cli.progress import say
from twinct.evaluation.figure import REFERENCE
from twinct.report.pose_words import named_pose_errors
from twinct.runs import Run
from twinct.runs.reconstruction_folder import stored_reconstructions


def say_result(run: Run) -> None:
    """Print the main figures, each in words: image, poses, report; or those of all volumes."""
    if "image" not in run.figures:
        for one in stored_reconstructions(run.paths.reconstructions).values():
            say(one.judged_in_words())
        say(f"report: {run.paths.report}")
        return
    image, poses = run.figures["image"], named_pose_errors(run.figures)
    errors = "; ".join(
        f"{name} {error['source']['position_mm']['mean']:.2f} mm source, "
        f"{error['detector']['position_mm']['mean']:.2f} mm detector"
        for name, error in poses.items()
    )
    material = run.figures.get("reference_material", REFERENCE)  # older runs do not say
    say(
        f"{run.figures['reached']} of {run.figures['views']} views; "
        f"RMSE {percent(image['rmse_rel'])} of mu({material}), "
        f"{percent(image['rmse_near_rel'])} near {material}\n"
        f"mean distance: {errors}\n"
        f"report: {run.paths.report}"
    )


def percent(share: float | None) -> str:
    """Return a share in percent; None, if no voxel counts, gives "no figure"."""
    return "no figure" if share is None else f"{100 * share:.1f} %"
