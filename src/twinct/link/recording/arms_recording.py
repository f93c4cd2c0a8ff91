"""Choices of an import from recordings of real arms."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ArmsRecording:
    """Recording of real arms: its topics, its scenario and its flat images.

    Attributes:
        scenario: Scenario of the scan, whose arms and specimen are used (default: the one that
            twinct drive recorded).
        image: Topic of the detector's images.
        joint_states: Topics of the drivers' joint states (default: those of twinct drive, else
            /joint_states).
        source_prefix: Prefix of the joint names of the source arm's driver.
        detector_prefix: Prefix of the joint names of the detector arm's driver.
        flat: Files of flat images, which are averaged; raw images need them.
        dark: Files of dark images.
        flip: Axes of the images that run opposite to v and u: rows, columns or both.
        latency_ms: Time from the middle of an exposure to its image's stamp, on the joints' clock.
        estimate_latency: Estimate that time from the images of the scenario's specimen.
    """

    scenario: Path | None = None
    image: str = "/xray/image"
    joint_states: tuple[str, ...] = ()
    source_prefix: str = ""
    detector_prefix: str = ""
    flat: tuple[Path, ...] = ()
    dark: tuple[Path, ...] = ()
    flip: tuple[str, ...] = ()
    latency_ms: float = 0.0
    estimate_latency: bool = False
