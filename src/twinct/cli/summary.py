"""Main figures of a run, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twinct.cli.progress import say

if TYPE_CHECKING:
    from twinct.runs import Run


def say_result(run: Run) -> None:
    """Print the main figures in two lines."""
    image, pose = run.figures["image"], run.figures["pose_error"]
    material = run.figures.get("reference_material", "bone")  # older runs do not say
    say(
        f"{run.figures['reached']} of {run.figures['views']} views; "
        f"RMSE {percent(image['rmse_rel'])} of mu({material}), "
        f"{percent(image['rmse_bone_rel'])} near {material}; "
        f"pose error {pose['source']['position_mm']['mean']:.2f} mm source, "
        f"{pose['detector']['position_mm']['mean']:.2f} mm detector\n"
        f"report: {run.paths.report}"
    )


def percent(share: float | None) -> str:
    """Return a share in percent; None, such as near bone without bone, gives "no figure"."""
    return "no figure" if share is None else f"{100 * share:.1f} %"
