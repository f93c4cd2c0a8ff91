"""Comparison of runs on one page; the first run is the reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from twinct.core.files.writing import write_text
from twinct.evaluation import IMAGE_FIGURES, MOTION_FIGURES
from twinct.report.data import CrossSection
from twinct.report.measured import nested, reasons
from twinct.report.page import stage_title
from twinct.report.pose_words import against_executed, named_pose_errors
from twinct.report.template import duration, fixed, rendered
from twinct.report.without_truth import FIGURES, differences, top_of
from twinct.scenario import Scenario
from twinct.scenario.digests import OF_ARMS
from twinct.scenario.imported import ScanSettings


@dataclass(frozen=True, eq=False)
class Compared:
    """One reconstruction in a comparison.

    Attributes:
        label: name on the page.
        path: path of its folder.
        scenario: scenario that made it, with its own reconstruction section.
        metrics: metrics of its run, see ``build_metrics``.
        image: figures of the volume by name, as ``metrics.json`` has them.
        in_words: algorithm, settings and results, in one line.
        seconds: seconds of each stage; for a reconstruction beside a run's own, only of its own
            stage.
        slices: the same planes for all, by name; None if a plane misses the grid.
        mu_reference: attenuation to which the figures are relative, 1/mm.
        reference: name of the material with this attenuation; empty without a truth.
        truth: identifier of the true specimen or, without one, of the images; equal for equal ones.
    """

    label: str
    path: str
    scenario: ScanSettings
    metrics: Mapping[str, Any]
    image: Mapping[str, float | None]
    in_words: str
    seconds: Mapping[str, float | None]
    slices: Mapping[str, CrossSection | None]
    mu_reference: float
    reference: str
    truth: str


@dataclass(frozen=True)
class Comparison:
    """Reconstructions to compare, the reference first."""

    compared: tuple[Compared, ...]

    @property
    def keys(self) -> dict[str, tuple[Any, ...]]:
        """Scenario keys that differ, with each reconstruction's value, or None without the key."""
        settings = [_keys_of(one.scenario) for one in self.compared]
        names = dict.fromkeys(name for values in settings for name in values)
        rows = {name: tuple(values.get(name) for values in settings) for name in names}
        return {name: row for name, row in rows.items() if any(v != row[0] for v in row)}

    @property
    def notes(self) -> list[str]:
        """Reasons why some figures cannot be compared."""
        first, *others = self.compared
        sentences: list[str] = []
        for one in others:
            both = f"{one.label} and {first.label}"
            if one.truth != first.truth and not self.has_truth:
                sentences.append(
                    f"{both} are volumes of different images: their residuals have no common scale."
                )
            elif one.truth != first.truth:
                sentences.append(
                    f"{both} show different specimens: each is judged against its own truth, and "
                    "the image figures are not compared."
                )
            elif (one.reference, f"{one.mu_reference:.6g}") != (
                first.reference,
                f"{first.mu_reference:.6g}",
            ):
                sentences.append(
                    f"{both} are relative to different attenuations, {one.mu_reference:.4g} and "
                    f"{first.mu_reference:.4g} per mm of {one.reference} and {first.reference}: "
                    "compare shares, not attenuations."
                )
            grids = (each.scenario.reconstruction.volume_grid for each in (one, first))
            if len({repr(grid) for grid in grids}) > 1:
                sentences.append(f"{both} have different grids: each is judged in its own voxels.")
            versions = [str(each.metrics.get("twinct_version")) for each in (one, first)]
            if versions[0] != versions[1]:
                sentences.append(f"{both} were made by twinct {' and '.join(versions)}.")
        if not self.has_truth:
            return sentences
        return sentences + reasons({one.label: one.image for one in self.compared})

    @property
    def has_truth(self) -> bool:
        """True if the volumes are judged by a truth."""
        return bool(self.compared[0].reference)

    def write(self, path: Path) -> None:
        """Write the page, completely or not at all.

        Raises:
            OSError: the page cannot be written.
        """
        write_text(path, self.render())

    def render(self) -> str:
        """Return the page as HTML text: images inline, no script, no external resources."""
        first = self.compared[0]
        return rendered(
            "compare.html",
            compared=self.compared,
            first=first,
            notes=self.notes,
            kicker="Twin robotic CT simulation" if self.has_truth else "Measured CT scan",
            about_slices=BESIDE_TRUTH if self.has_truth else WITHOUT_TRUTH,
            pictures=self.pictures(),
            tables=self.tables(),
            keys=self.keys,
        )

    def tables(self) -> dict[str, list[ComparisonRow]]:
        """Return the rows of each table by its title."""
        if not self.has_truth:
            seconds = [row for row in time_rows(self.compared) if row.title == "reconstruction"]
            return {"What can be judged": _judged_rows(self.compared), "Time": seconds}
        return {
            "Image figures": _image_rows(self.compared),
            "Pose errors": _pose_rows(self.compared),
            "Time": time_rows(self.compared),
        }

    def pictures(self) -> list[tuple[str, str]]:
        """Return a title and the address of an image for each plane."""
        return _pictures(self.compared)


BESIDE_TRUTH = (
    "All volumes show the same planes of the world, with one window and one scale. Each is in its "
    "own voxels, above its error against its own truth. Where a volume's own plane lies up to half "
    "a voxel away, its position is given; a grid that is turned against the first one shows its "
    "nearest voxels. The outline bounds the region that every view sees; the figures above are "
    "computed in it."
)
WITHOUT_TRUTH = (
    "All volumes show the same planes of the first one's frame, in one window, each in its own "
    "voxels; below, the difference from the first, where both have the same voxels."
)


def _keys_of(scenario: ScanSettings) -> dict[str, Any]:
    """Return all keys that count for a scenario: a gantry has no motion."""
    keys = flat(scenario.model_dump(mode="json"))
    if not isinstance(scenario, Scenario) or scenario.cell.kind != "gantry":
        return keys
    left_out = tuple(f"{section}." for section in OF_ARMS)
    return {key: value for key, value in keys.items() if not f"{key}.".startswith(left_out)}


def flat(data: Mapping[str, Any], key: str = "") -> dict[str, Any]:
    """Flatten nested keys to dotted ones. Lists of sections get indices; other lists stay lists."""
    entries: dict[str, Any] = {}
    for name, value in data.items():
        inner = f"{key}{name}"
        if isinstance(value, list) and value and all(isinstance(v, dict) for v in value):
            value = {str(index): item for index, item in enumerate(value)}
        entries |= flat(value, f"{inner}.") if isinstance(value, dict) else {inner: value}
    return entries


class ComparisonRow(NamedTuple):
    """Values, and the differences from the first value, both as text."""

    title: str
    unit: str
    cells: list[tuple[str, str]]
    meaning: str = ""


def row_of(
    title: str,
    unit: str,
    values: Sequence[float | None],
    text: Callable[[float | None], str],
    meaning: str = "",
    alike: Sequence[bool] | None = None,
) -> ComparisonRow:
    """Return a row; a value that is not ``alike`` with the first has no difference."""
    first, cells = values[0], [(text(values[0]), "")]
    for value, counts in zip(values[1:], (alike or [True] * len(values))[1:], strict=True):
        difference = ""
        if counts and value is not None and first is not None:
            change = value - first
            sign, size = "+" if change > 0 else "−", text(abs(change))
            difference = f"{sign}{size}" if size != text(0.0) else "≈" if change else "="
        cells.append((text(value), difference))
    return ComparisonRow(title, unit, cells, meaning)


def _judged_rows(compared: Sequence[Compared]) -> list[ComparisonRow]:
    """Return the rows of figures that need no truth."""
    alike = [one.truth == compared[0].truth for one in compared]
    return [
        row_of(
            figure.title,
            figure.unit,
            [one.image.get(key) for one in compared],
            partial(fixed, digits=figure.digits, factor=figure.factor),
            figure.meaning,
            alike,
        )
        for key, figure in FIGURES.items()
    ]


def _image_rows(compared: Sequence[Compared]) -> list[ComparisonRow]:
    materials = "/".join(dict.fromkeys(one.reference for one in compared))
    alike = [one.truth == compared[0].truth for one in compared]
    moves = any(one.scenario.specimen and one.scenario.specimen.motion for one in compared)
    figures = (*IMAGE_FIGURES, *(MOTION_FIGURES if moves else ()))
    return [
        row_of(
            shown.title,
            shown.unit,
            [nested(one.image, shown.key) for one in compared],
            partial(fixed, digits=shown.digits, factor=shown.factor),
            f"{shown.meaning}; good: {shown.good}",
            alike,
        )
        for shown in (one.relative_to(materials) for one in figures)
    ]


def _pose_rows(compared: Sequence[Compared]) -> list[ComparisonRow]:
    """Return rows for executed against commanded poses, then for geometries against executed.

    These are the believed one and, if others are reconstructed, the others.
    """
    metrics = [one.metrics for one in compared]
    by_name: dict[str, list[Any]] = {}
    for index, one in enumerate(compared):
        errors = dict(named_pose_errors(one.metrics))
        used = one.scenario.reconstruction.geometries[0]
        if (other := one.metrics.get("geometries", {}).get(used)) and not one.metrics.get("drive"):
            errors[against_executed(used)] = other["pose_error"]
        for name, error in errors.items():
            by_name.setdefault(name, [None] * len(compared))[index] = error
    rows: list[ComparisonRow] = []
    for what, of in by_name.items():
        for arm in ("source", "detector"):
            for kind, name, unit in (
                ("position_mm", "position", "mm"),
                ("rotation_deg", "rotation", "deg"),
            ):
                for statistic in ("mean", "max"):
                    values = [_nested(one, arm, kind, statistic) for one in of]
                    title = f"{arm}, {name}, {statistic}"
                    rows.append(row_of(title, unit, values, partial(fixed, digits=3), what))
    gaps = [_nested(one, "clearance_mm", "min") for one in metrics]
    rows.append(row_of("smallest clearance", "mm", gaps, partial(fixed, digits=1)))
    return [row for row in rows if any(text != fixed(None) for text, _ in row.cells)]


def time_rows(compared: Sequence[Compared]) -> list[ComparisonRow]:
    """Return the seconds of each stage, and the simulated ones."""
    stages = dict.fromkeys(name for one in compared for name in one.seconds if name != "total")
    rows = [
        row_of(stage_title(name), "", [one.seconds.get(name) for one in compared], duration)
        for name in (*stages, "total")
    ]
    simulated = [_nested(one.metrics, "simulated_seconds") for one in compared]
    return [*rows, row_of("simulated time", "", simulated, duration)]


def _nested(data: Any, *keys: str) -> float | None:
    """Return a nested value; None if it is missing, as in figures of older versions."""
    for key in keys:
        data = data.get(key) if isinstance(data, Mapping) else None
    return data


def _pictures(compared: Sequence[Compared]) -> list[tuple[str, str]]:
    """Return a title and the address of an image for each plane."""
    from twinct.report.figures import side_by_side, windows

    first = compared[0]
    every = [s for one in compared for s in one.slices.values() if s is not None]
    truth = f"truth of {first.label}" if len({one.truth for one in compared}) > 1 else "truth"
    pictures: list[tuple[str, str]] = []
    for name, section in first.slices.items():
        assert section is not None
        columns = {one.label: one.slices[name] for one in compared}
        if first.reference:
            picture = side_by_side(columns, truth, windows(every, first.mu_reference))
        else:
            picture = differences(columns, top_of(every))
        pictures.append((f"{name}, {section.position}", picture.data_uri))
    return pictures
