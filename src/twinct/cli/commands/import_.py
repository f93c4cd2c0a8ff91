"""``twinct import``: a measured scan, or recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import Flag
from twinct.cli.optional import mark_optional
from twinct.cli.progress import on_terminal
from twinct.link.recording.arms_recording import ArmsRecording
from twinct.measured.import_scan import import_scan

mark_optional(ArmsRecording, "arms.")


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
    with its poses, cameras and images, as a measured scan.

    From recordings of real arms, made by twinct drive or with --arms.scenario, the executed poses
    are those of the joints at the time of each image.

    Args:
        out: Folder to write, without a run in it.
        try_: For a measured scan: import nothing, but try other conventions (direction of rotation,
            flips, transposed images, exchanged axes, sign and unit of offsets), rank them, and show
            them in DIR/tried.png.
    """
    with on_terminal() as audience:
        import_scan(files, out, try_conventions=try_, arms=arms, observers=audience)
