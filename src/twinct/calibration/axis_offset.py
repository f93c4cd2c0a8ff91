"""Axis of a circular scan from few rows: the offset at which a volume predicts left-out views best.

Rays of one row lie in a plane, and the volume is a slice. Planes through two sources tell nothing
of the axis then, nor in a parallel beam, where each holds one row of each panel. But a slice that
is reconstructed from every other view predicts the others only if the axis is right. Half a turn
is enough in a parallel beam: opposite rays are not needed. The object may reach beyond the panel.

The sum of squares that is left is searched over the whole panel in coarse pixels, and then near its
minimum in ever finer ones, where it is a parabola. Parts of the views show how sure the minimum is
(jackknife; Efron and Stein, Ann. Stat. 9 (1981) 586).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twinct.core.errors import CalibrationError
from twinct.core.progress import SILENT, Progress
from twinct.diagnosis.left_out import left_out
from twinct.geometry import Floats, Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import CircularOrbit, Projector
from twinct.recon.checks import Mask
from twinct.recon.engine import Singles
from twinct.recon.resolution import binned

COLUMNS = (40, 80, 160, 320)
"""Numbers of columns in each round, about."""

FARTHEST = 0.5
"""Largest offset that is tried, in widths of the panel: beyond, the panel misses the axis."""

MARGIN = 0.25
"""How far the slice reaches beyond what the panel sees, relative to it: it may be cut off."""

MOST_VIEWS = 240
"""Largest number of views, half of them reconstructed."""

FEWEST_VIEWS = 16
"""Smallest number of views of which half predict the others."""

LEAST_ARC_DEG = 170.0
"""Smallest arc of the views. Over 120 degrees, the minimum lay 1 px off, its deviation was 0.6."""

PARTS = 8
"""Runs of neighbouring views that are left out in turn to see how sure the minimum is."""


@dataclass(frozen=True)
class AxisOffset:
    """Place of the panel along its columns.

    Attributes:
        shift_mm: from where it is believed.
        deviation_mm: standard deviation of the shift.
        residuals: root mean square of what left-out views differ by, relative to that of the views,
            where the panel is believed and where it was found, in the finest pixels.
    """

    shift_mm: float
    deviation_mm: float
    residuals: tuple[float, float]


def axis_offset(
    line_integrals: Singles,
    believed: ScanGeometry,
    circle: CircularOrbit,
    *,
    mask: Mask | None = None,
    progress: Progress = SILENT,
) -> AxisOffset:
    """Return by how much the panel of a circular scan lies beside its believed place.

    Args:
        line_integrals: (views, rows, columns).
        believed: approximate geometry, a circle.
        circle: circle of its sources.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        progress: receives a step for each round.

    Raises:
        CalibrationError: there are too few views, they cover less than half a turn, or parts of
            them tell other offsets.
    """
    views = len(believed)
    if views < FEWEST_VIEWS:
        raise CalibrationError(f"{views} views do not tell the axis: {FEWEST_VIEWS} are needed")
    if (arc := np.degrees(circle.span)) < LEAST_ARC_DEG:
        raise CalibrationError(
            f"views over {arc:.0f} deg do not tell the axis: half a turn is needed"
        )
    some = np.unique(np.linspace(0, views - 1, min(views, MOST_VIEWS)).round().astype(int))
    of_views = mask[some] if mask is not None and mask.ndim == 3 else mask
    p, geometry = line_integrals[some], believed[some]
    columns = believed.panel.columns
    factors = sorted({max(round(columns / number), 1) for number in COLUMNS}, reverse=True)
    reach = int(FARTHEST * columns / factors[0])
    shift, found = 0.0, None
    with progress.stage("axis", len(factors)) as step:
        for factor in factors:
            fan = _Fan.of(p, geometry, circle, of_views, factor)
            found = fan.least(shift, reach)
            shift, reach = found.shift_mm, 1
            step()
    assert found is not None
    return found


@dataclass(frozen=True, eq=False)
class _Fan:
    """One row of large pixels, as rays in the plane of the circle.

    Attributes:
        p: line integrals, (views, 1, columns).
        counts: pixels that count.
        geometry: the views.
        circle: circle of the sources.
    """

    p: Singles
    counts: Mask | None
    geometry: ScanGeometry
    circle: CircularOrbit
    _squares: dict[float, Floats] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        p: Singles,
        geometry: ScanGeometry,
        circle: CircularOrbit,
        mask: Mask | None,
        factor: int,
    ) -> _Fan:
        """Take the rows that are nearest to the plane, as many as make a pixel square."""
        rows = min(factor, geometry.panel.rows)
        row = float(np.median(geometry.project(circle.centre)[:, 0, 1]))
        first = int(np.clip(round(row - (rows - 1) / 2), 0, geometry.panel.rows - rows))
        own = slice(first, first + rows)
        pixels = None if mask is None else mask[..., own, :]
        large, counts = binned(p[:, own], pixels, (rows, factor))
        views = geometry.binned(1, factor)
        height = rows * views.panel.pitch_v
        up = views.panel.pitch_v * (first + (rows - 1) / 2 - views.panel.middle[1])
        panel = Panel(1, views.panel.columns, views.panel.pitch_u, height)
        row_of = views.detector + up * views.v
        off = (row_of - circle.centre) @ circle.axis
        # Nearly in the plane: there the rays of all views cross the slice.
        u = views.u - np.outer(views.u @ circle.axis, circle.axis)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        sense = np.sign(views.v @ circle.axis)[:, None]
        flat = ScanGeometry(
            views.source - np.outer((views.source - circle.centre) @ circle.axis, circle.axis),
            row_of - np.outer(off, circle.axis),
            u,
            sense * circle.axis,
            panel,
        )
        return cls(large, counts, flat, circle)

    def least(self, middle: float, reach: int) -> AxisOffset:
        """Return the shift with the least squares, some pixels around one or farther."""
        pitch = self.geometry.panel.pitch_u
        at = {n: self.squares(middle + n * pitch) for n in range(-reach, reach + 1)}
        least = min(at, key=lambda n: float(at[n].sum()))
        while not {least - 1, least + 1} <= at.keys():
            for n in {least - 1, least + 1} - at.keys():
                at[n] = self.squares(middle + n * pitch)
            least = min(at, key=lambda n: float(at[n].sum()))
        parts = np.arange(len(at[least])) * PARTS // len(at[least])
        kept = [parts != part for part in range(PARTS)]
        nearest = [min(at, key=lambda n, own=own: float(at[n][own].sum())) for own in kept]
        if np.abs(np.array(nearest) - least).max() > 1:
            low, high = (middle + n * pitch for n in (min(nearest), max(nearest)))
            raise CalibrationError(
                f"the views do not tell the axis: parts of them move the panel by {low:+.3g} to "
                f"{high:+.3g} mm. Is there an object in the rows near the plane of the source?"
            )
        three = np.stack([at[least + n] for n in (-1, 0, 1)])
        each = [_lowest(three[:, own].sum(axis=1)) for own in kept]
        deviation = pitch * float(np.sqrt((PARTS - 1) * np.var(each)))
        shift = middle + (least + _lowest(three.sum(axis=1))) * pitch
        whole = max(float(np.square(self.p[1::2], dtype=np.float64).sum()), 1e-30)
        before, after = (float(np.sqrt(self.squares(x).sum() / whole)) for x in (0.0, shift))
        return AxisOffset(shift, deviation, (before, after))

    def squares(self, shift: float) -> Floats:
        """Return what each left-out view leaves where the panel is shifted so far, (views,)."""
        if shift not in self._squares:
            views = replace(
                self.geometry, detector=self.geometry.detector + shift * self.geometry.u
            )
            A = Projector(views, self._slice(shift))
            self._squares[shift] = left_out(A, self.p, self.counts).squares
        return self._squares[shift]

    def _slice(self, shift: float) -> VolumeGrid:
        """Return a grid of what the panel sees where it is shifted so far, and somewhat more."""
        panel, views = self.geometry.panel, self.geometry
        scale = float(np.median(views.depth(self.circle.centre) / views.sdd))
        off = float(np.abs(views.project(self.circle.centre)[:, 0, 0] - panel.middle[0]).max())
        reach = panel.columns / 2 + off + abs(shift) / panel.pitch_u
        edge = scale * panel.pitch_u
        number = int(np.ceil(2 * (1 + MARGIN) * reach))
        x = views.source[0] - self.circle.centre
        x /= np.linalg.norm(x)
        axes = np.stack([x, np.cross(self.circle.axis, x), self.circle.axis], axis=1)
        place = Pose.from_matrix(self.circle.centre, axes)
        return VolumeGrid((3, number, number), edge, place)


def _lowest(three: Floats) -> float:
    """Return where a parabola through values at -1, 0 and 1 is lowest, between -1 and 1."""
    bend = three[0] + three[2] - 2 * three[1]
    return float(np.clip((three[0] - three[2]) / 2 / max(bend, 1e-30), -1, 1))
