"""Pictures of a report. Each function returns one image, and leaves pyplot's global state alone."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import proj3d
from numpy.typing import NDArray
from PIL import Image as PillowImage

from twinct.evaluation import PoseErrors
from twinct.geometry import Floats, Panel
from twinct.report.data import CrossSection
from twinct.report.style import (
    DETECTOR_COLOUR,
    INK,
    LIMIT_COLOUR,
    REGION_COLOUR,
    SOURCE_COLOUR,
    STYLE,
    WIDTH,
    Picture,
)

SPHERE_TOLERANCE = 0.01
"""Largest relative spread of the source distances on a path that counts as spherical."""

DARKEST_DRAWN = 1e-7
"""Smallest transmission that is shown; its line integral is 16.1."""


def png(figure: Figure, dpi: int) -> Picture:
    """Render a figure as pixels."""
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(dpi)
    canvas.draw()
    image = PillowImage.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    stream = io.BytesIO()
    image.save(stream, "PNG")
    return Picture(stream.getvalue(), "image/png")


def svg(figure: Figure) -> Picture:
    """Render a figure as lines and letters; the same figure gives the same bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return Picture(stream.getvalue(), "image/svg+xml")


def source_path(commanded: Floats, executed: Floats, isocentre: Floats) -> Picture:
    """Draw the source path on a grey sphere about the isocentre, as in the paper's figure 3, left.

    The sphere is left out if the path is not on a sphere. The focal spots, commanded and executed,
    are (views, 3), mm.
    """
    distance = np.linalg.norm(commanded - isocentre, axis=1)
    radius = float(distance.mean())
    on_sphere = radius > 0 and np.ptp(distance) <= SPHERE_TOLERANCE * radius
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 4.7))
        frame = (-0.05, 0.0, 0.94, 1.02)
        axes: Any = figure.add_axes(frame, projection="3d", computed_zorder=False)
        axes.set_proj_type("ortho")
        middle = commanded[len(commanded) // 2] - isocentre
        azimuth, elevation = math.degrees(math.atan2(middle[1], middle[0])) - 22, 22.0
        axes.view_init(elev=elevation, azim=azimuth)
        a, e = math.radians(azimuth), math.radians(elevation)
        viewer = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])

        if on_sphere:
            _latitudes(axes, isocentre, radius, viewer)
        colours = mpl.colormaps["viridis"](np.linspace(0, 0.93, len(commanded)))
        # The path behind the sphere is drawn on it, faintly: an opaque sphere has no seams.
        path = isocentre + _fine(commanded - isocentre) if on_sphere else commanded
        ahead, front = ((points - isocentre) @ viewer >= 0 for points in (path, commanded))
        dot = next(s for s, most in ((24, 30), (11, 150), (6, math.inf)) if len(commanded) <= most)
        for along, part, order, faint in ((~ahead, ~front, 4, on_sphere), (ahead, front, 6, False)):
            line = np.where(along[:, None], path, np.nan)
            axes.plot(*line.T, color=INK, lw=0.9, alpha=0.5 if faint else 1.0, zorder=order + 1)
            style = {"s": 0.8 * dot, "alpha": 0.45} if faint else {"s": dot, "alpha": 1.0}
            style |= {"c": colours[part], "depthshade": False, "linewidths": 0, "zorder": order}
            axes.scatter(*executed[part].T, **style)
        ends = isocentre + 1.13 * (commanded[[0, -1]] - isocentre)
        for point, label, side in zip(
            ends, ("first", "last"), _sides(ends, viewer, isocentre), strict=True
        ):
            label = {"right": f"{label} ", "left": f" {label}"}.get(side, label)
            axes.text(*point, label, fontsize=8.5, ha=side, va="bottom", zorder=9)
        axes.scatter(*isocentre, marker="+", s=60, c="#111111", lw=1.3, zorder=8)
        name = "  isocentre (inside)" if on_sphere else "  isocentre"
        axes.text(*isocentre, name, fontsize=8.5, va="center", zorder=8)
        _equal_box(axes, np.vstack([commanded, executed, isocentre[None]]), isocentre, on_sphere)
        if on_sphere:
            _ball(axes, isocentre, radius, viewer)
        views = ScalarMappable(Normalize(-0.5, len(commanded) - 0.5), ListedColormap(colours))
        bar = figure.colorbar(views, ax=axes, cax=figure.add_axes((0.885, 0.27, 0.022, 0.46)))
        bar.set_label("view")
        bar.locator = MaxNLocator(5, integer=True)
        bar.outline.set_visible(False)
        return png(figure, 180)


_NEAR = 0.35
"""Distance on the screen, relative to that from the isocentre, at which two labels touch."""


def _sides(points: Floats, viewer: Floats, isocentre: Floats) -> tuple[str, str]:
    """Return how the labels of two points (2, 3) are aligned: side by side if they would touch."""
    apart = points[0] - points[1]
    across = np.cross([0, 0, 1.0], viewer)
    seen = np.linalg.norm(apart - (apart @ viewer) * viewer)
    if seen > _NEAR * np.linalg.norm(points[0] - isocentre):
        return "center", "center"
    return ("left", "right") if apart @ across > 0 else ("right", "left")


_FINEST_RAD = 0.02
"""Longest step of a path on a sphere: straight chords between few views would run inside it."""


def _fine(path: Floats) -> Floats:
    """Return the same path about the origin, with additional points on great circles."""
    pieces = [path[:1]]
    for start, end in zip(path[:-1], path[1:], strict=True):
        lengths = float(np.linalg.norm(start)), float(np.linalg.norm(end))
        angle = math.acos(float(np.clip(start @ end / (lengths[0] * lengths[1]), -1, 1)))
        share = np.linspace(0, 1, 1 + max(1, math.ceil(angle / _FINEST_RAD)))[1:, None]
        between = start + share * (end - start)
        radius = lengths[0] + share * (lengths[1] - lengths[0])
        pieces.append(between * radius / np.linalg.norm(between, axis=1, keepdims=True))
    return np.vstack(pieces)


def _ball(axes: Any, centre: Floats, radius: float, viewer: Floats) -> None:
    """Draw a light grey ball, brightest at the upper left; the axes' limits must be final.

    The projection is parallel and of equal scale, so the ball is a disc. One image is drawn faster
    than thousands of facets, and has no edges.
    """
    right = np.cross([0.0, 0.0, 1.0], viewer)
    right /= np.linalg.norm(right)
    up = np.cross(viewer, right)
    light = viewer - 0.5 * right + [0.0, 0.0, 0.7]
    light /= np.linalg.norm(light)
    across = np.linspace(-1, 1, _BALL_PX)
    x, y = np.meshgrid(across, across)
    depth = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    lit = np.clip(x * (right @ light) + y * (up @ light) + depth * (viewer @ light), 0, 1)
    grey = 0.66 + 0.27 * lit
    border = np.clip((1 - np.hypot(x, y)) * _BALL_PX / 2, 0, 1)
    shown = np.stack([grey, grey, np.minimum(grey + 0.012, 1), border], axis=-1)
    corners = np.array([centre - radius * (right + up), centre + radius * (right + up)])
    xs, ys, zs = corners.T
    (left, end), (low, top), _ = proj3d.proj_transform(xs, ys, zs, axes.get_proj())
    image = AxesImage(axes, extent=(left, end, low, top), origin="lower", zorder=2)
    image.set_data(shown)
    axes.add_artist(image)


_BALL_PX = 401
"""Pixels across the picture of a ball."""


def _latitudes(axes: Any, centre: Floats, radius: float, viewer: Floats) -> None:
    """Draw the front halves of the circles of latitude."""
    turn = np.linspace(-180, 180, 361)
    for latitude in (-60, -30, 0, 30, 60):
        ring = _on_ball(turn, np.full_like(turn, latitude))
        ring[:, viewer @ ring < 0] = np.nan
        axes.plot(*(centre[:, None] + radius * ring), color="white", lw=0.6, alpha=0.8, zorder=3)


def _on_ball(longitude_deg: Floats, latitude_deg: Floats) -> Floats:
    """Return points of the unit sphere, (3, ...)."""
    a, e = np.radians(longitude_deg), np.radians(latitude_deg)
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _equal_box(axes: Any, points: Floats, centre: Floats, on_sphere: bool) -> None:
    """Set equal scales on all axes, with the isocentre in the middle and ticks in mm."""
    half = np.abs(points - centre).max(axis=0)
    half = np.full(3, half.max()) if on_sphere else np.maximum(half, 0.15 * half.max())
    half = 1.02 * np.maximum(half, 1e-6)
    for name, middle, reach in zip("xyz", centre, half, strict=True):
        getattr(axes, f"set_{name}lim")(middle - reach, middle + reach)
        getattr(axes, f"set_{name}label")(f"{name} / mm", labelpad=1)
        axis, locator = getattr(axes, f"{name}axis"), MaxNLocator(5, steps=[1, 2, 5, 10])
        ticks = locator.tick_values(middle - 0.85 * reach, middle + 0.85 * reach)
        axis.set_ticks(ticks[np.abs(ticks - middle) < 0.95 * reach])
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor("#d5dae0")
        axis._axinfo["grid"].update(color="#e4e7eb", linewidth=0.6)
    axes.tick_params(pad=-1, labelsize=7.5)
    axes.set_box_aspect(tuple(half), zoom=0.93)


def pose_errors_over_views(
    errors: PoseErrors, clearance_mm: Floats, tolerance_mm: float, clearance_limit_mm: float
) -> Picture:
    """Plot position error, rotation error and clearance over the views, one below the other.

    A target counts as reached at the tolerance. The limit is the smallest gap that a plan may have.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 5.6), layout="constrained")
        position, rotation, clearance = figure.subplots(3, 1, sharex=True)
        views = np.arange(len(errors.source.position_mm))
        style = {"lw": 1.1, "marker": "o", "ms": 2.2 if len(views) <= 150 else 0}
        # Wide below narrow: equal lines both show.
        wide = ("source", SOURCE_COLOUR, 2.6), ("detector", DETECTOR_COLOUR, 1.1)
        for label, colour, width in wide:
            arm, how = getattr(errors, label), style | {"lw": width}
            position.plot(views, arm.position_mm, color=colour, label=label, **how)
            rotation.plot(views, arm.rotation_deg, color=colour, label=label, **how)
        clearance.plot(np.arange(len(clearance_mm)), clearance_mm, color="#3d7a4d", **style)
        _limit(position, tolerance_mm, f"tolerance {tolerance_mm:g} mm")
        _limit(clearance, clearance_limit_mm, f"planned at least {clearance_limit_mm:g} mm")
        labels = "position error / mm", "rotation error / deg", "clearance / mm"
        for axes, label in zip((position, rotation, clearance), labels, strict=True):
            axes.set_ylabel(label)
            axes.set_ylim(bottom=0)
            axes.margins(x=0.01)
            axes.grid(axis="y", color="#e4e7eb", lw=0.7)
            axes.set_axisbelow(True)
        # The legend lies above the plots, clear of data and limit.
        named, place = position.get_legend_handles_labels(), "outside upper right"
        figure.legend(*named, loc=place, ncols=2, borderpad=0)
        clearance.set_xlabel("view")
        clearance.xaxis.set_major_locator(MaxNLocator(10, integer=True))
        figure.align_ylabels()
        return svg(figure)


def _limit(axes: Any, value: float, label: str) -> None:
    axes.axhline(value, color=LIMIT_COLOUR, lw=1, ls=(0, (4, 3)))
    shift = {"xycoords": ("axes fraction", "data"), "xytext": (0, 2), "textcoords": "offset points"}
    axes.annotate(label, (0.004, value), **shift, va="bottom", fontsize=8, color=LIMIT_COLOUR)
    axes.set_ylim(top=max(axes.get_ylim()[1], 1.2 * value))


def cross_section_grid(
    sections: Mapping[str, CrossSection],
    mu_reference: float,
    compared: Sequence[CrossSection] = (),
) -> Picture:
    """Draw reconstruction, truth and their difference for each plane, with scales in mm.

    Reconstruction and truth share one grey window; the window of the error is symmetric about 0.
    The outline is the boundary of the region that every view sees. The windows also fit
    ``compared``.
    """
    (_, grey), (diverging, errors) = looks = windows([*sections.values(), *compared], mu_reference)
    bounds = (section.extent_mm for section in sections.values())
    shares = [(top - bottom) / (right - left) for left, right, bottom, top in bounds]
    with mpl.rc_context(STYLE):
        rows = len(sections)
        height = 2.9 * sum(shares) + 0.42 * rows + 0.75
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        grid = figure.subplots(rows, 3, squeeze=False, height_ratios=shares)
        _pad(figure, w_pad=0.03, h_pad=0.06, wspace=0.0, hspace=0.0)
        for line, (name, section) in zip(grid, sections.items(), strict=True):
            images = section.reconstruction, section.known_truth, section.error
            for axes, image, (cmap, norm) in zip(line, images, (looks[0], *looks), strict=True):
                axes.imshow(image, cmap=cmap, norm=norm, origin="lower", extent=section.extent_mm)
                _outline(axes, section, REGION_COLOUR if cmap == "gray" else INK)
                axes.xaxis.set_major_locator(MaxNLocator(5))
                axes.yaxis.set_major_locator(MaxNLocator(5))
                axes.set_xlabel(f"{section.axes[0]} / mm".lstrip(" /"), labelpad=1)
                if axes is not line[0]:
                    axes.tick_params(left=False, labelleft=False)
            line[0].set_ylabel(f"{section.axes[1]} / mm".lstrip(" /"), labelpad=1)
            plane = f"{name}, {section.position}".rstrip(", ")
            style = {"rotation": 90, "ha": "center", "va": "center", "weight": "bold"}
            line[0].text(-0.24, 0.5, plane, transform=line[0].transAxes, **style)
        titles = "reconstruction", "truth", "reconstruction − truth"
        for axes, title in zip(grid[0], titles, strict=True):
            axes.set_title(title, weight="bold")
        for columns, cmap, norm, shrink, aspect, label in (
            (grid[:, :2], "gray", grey, 0.5, 34, "attenuation / mm⁻¹"),
            (grid[:, 2:], diverging, errors, 0.9, 30, "error / mm⁻¹"),
        ):
            _bar_below(figure, columns, (cmap, norm), label, shrink=shrink, aspect=aspect)
        return png(figure, 150)


_ABREAST = 4
"""Number of pictures side by side; further ones go below."""


def side_by_side(
    columns: Mapping[str, CrossSection | None],
    truth: str,
    looks: Sequence[Look],
    dpi: int = 150,
) -> Picture:
    """Draw the same plane of several volumes: each reconstruction, and its error below.

    All have the same extent and the same windows. The truth of the first volume comes first.

    Args:
        columns: section of each volume, by name; None if the plane misses its grid.
        truth: title of the truth's column.
        looks: looks from ``windows`` for all compared sections.
        dpi: pixels per inch; a page shows about 100.
    """
    sections = [section for section in columns.values() if section is not None]
    first, extents = sections[0], np.array([section.extent_mm for section in sections])
    (left, bottom), (right, top) = extents.min(axis=0)[[0, 2]], extents.max(axis=0)[[1, 3]]
    cells = [(truth, first._replace(reconstruction=first.known_truth)), *columns.items()]
    abreast = min(_ABREAST, len(cells))
    bands = [cells[i : i + abreast] for i in range(0, len(cells), abreast)]
    height = (WIDTH - 0.7) / abreast * (top - bottom) / (right - left)
    with mpl.rc_context(STYLE):
        size = (WIDTH, len(bands) * (2 * height + 1.0) + 0.75)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(2 * len(bands), abreast, squeeze=False)
        _pad(figure, w_pad=0.03, h_pad=0.06, wspace=0.0, hspace=0.0)
        for axes in grid.flat:
            axes.set_visible(False)
        for index, (name, section) in enumerate(cells):
            band, column = divmod(index, abreast)
            title = [*textwrap.wrap(name, 100 // abreast)]
            if section is not None and section.position != first.position:
                title.append(f"({section.position})")
            for line, look in enumerate(looks[: 1 if index == 0 else 2]):
                axes = grid[2 * band + line, column]
                axes.set_facecolor(_OUTSIDE)
                for axis in (axes.xaxis, axes.yaxis):
                    axis.set_major_locator(MaxNLocator(5))
                axes.set_ylabel(f"{first.axes[1]} / mm", labelpad=1)
                if column and not (line and index == 1):
                    axes.tick_params(left=False, labelleft=False)
                    axes.set_ylabel("")
                if line == 0:
                    axes.set_title("\n".join(title), weight="bold")
                if line or index == 0:
                    axes.set_xlabel(f"{first.axes[0]} / mm", labelpad=1)
                else:
                    axes.tick_params(labelbottom=False)
                _show(axes, section, look, error=line == 1)
                axes.set(visible=True, xlim=(left, right), ylim=(bottom, top), aspect="equal")
        half = abreast // 2
        for part, look, label in (
            (grid[:, :half], looks[0], "attenuation / mm⁻¹"),
            (grid[:, half:], looks[1], "reconstruction − truth / mm⁻¹"),
        ):
            _bar_below(figure, part, look, label, shrink=0.8, aspect=30)
        return png(figure, dpi)


def _show(axes: Any, section: CrossSection | None, look: Look, error: bool) -> None:
    """Draw a section of a reconstruction, or its error; or say that there is none."""
    if section is None:
        said = {"transform": axes.transAxes, "ha": "center", "va": "center"}
        axes.text(0.5, 0.5, "outside its grid", **said, color=LIMIT_COLOUR)
        return
    shown = section.error if error else section.reconstruction.astype(np.float64)
    cmap, norm = look
    axes.imshow(shown, cmap=cmap, norm=norm, origin="lower", extent=section.extent_mm)
    _outline(axes, section, INK if error else REGION_COLOUR)


_OUTSIDE = "#eceff2"
"""Colour outside a grid."""


def _bar_below(figure: Figure, columns: Any, look: Look, label: str, **style: float) -> None:
    cmap, norm = look
    where: dict[str, Any] = {"location": "bottom", "extend": "both", **style}
    bar = figure.colorbar(ScalarMappable(norm, cmap), ax=columns, **where)
    bar.set_label(label, labelpad=2)
    bar.locator = MaxNLocator(5)
    bar.outline.set_linewidth(0.5)


Look = tuple[Any, Normalize]
"""Colours and window of an image."""


def windows(sections: Sequence[CrossSection], mu_reference: float) -> tuple[Look, Look]:
    """Return the looks of attenuations and of errors, each with one window for all sections."""
    worst = _nice(max(_typical_worst(section) for section in sections) or 0.1 * mu_reference)
    diverging = mpl.colormaps["RdBu_r"].resampled(63)  # odd, so that 0 is white; noise packs better
    return ("gray", _grey_window(sections, mu_reference)), (diverging, Normalize(-worst, worst))


BRIGHTEST = 2.0
"""Largest upper limit of the grey window, in attenuations of the reference.

Denser metal is white, so that bone or aluminium does not turn black.
"""


def _grey_window(sections: Sequence[CrossSection], mu_reference: float) -> Normalize:
    densest = max(float(section.known_truth.max()) for section in sections)
    end = min(max(densest, mu_reference), BRIGHTEST * mu_reference)
    return Normalize(-0.1 * end, 1.2 * end)


def _pad(figure: Figure, **pads: Any) -> None:
    engine: Any = figure.get_layout_engine()
    engine.set(**pads)


def _typical_worst(section: CrossSection) -> float:
    """Return the error that is exceeded by 0.5 % of the voxels in the region."""
    error = np.abs(section.error)
    seen = error[section.roi] if section.roi.any() else error
    return float(np.nanpercentile(seen, 99.5))  # NaN is outside a rotated grid


def _nice(value: float) -> float:
    """Round up to one leading digit."""
    step = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / step * (1 - 1e-9)) * step


def _outline(axes: Any, section: CrossSection, colour: str) -> None:
    """Draw the boundary of the region, along the middle line of the voxel edges."""
    roi = np.pad(section.roi, 1)  # closes a region that reaches the edge
    if not roi.any() or section.roi.all():
        return
    left, right, bottom, top = section.extent_mm
    rows, columns = section.roi.shape
    dx, dy = (right - left) / columns, (top - bottom) / rows
    x = left + (np.arange(columns + 2) - 0.5) * dx
    y = bottom + (np.arange(rows + 2) - 0.5) * dy
    axes.contour(x, y, roi, levels=[0.5], colors=[colour], linewidths=1.0)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)


def projection_strip(
    projections: Sequence[tuple[int, NDArray[np.floating]]], panel: Panel
) -> Picture:
    """Draw a few projections as line integrals -ln(I/I0), in one grey window, seen from the source.

    They are (view, transmission (row, col)). Row 0 is at the bottom; v points up.
    """
    transmissions = [image.astype(np.float64) for _, image in projections]
    integrals = [-np.log(np.clip(image, DARKEST_DRAWN, None)) for image in transmissions]
    norm = Normalize(0, max(float(np.percentile(np.stack(integrals), 99.9)), 1e-6))
    width, height = panel.size_mm
    extent = (-width / 2, width / 2, -height / 2, height / 2)
    per_row = min(4, len(projections)) if len(projections) != 6 else 3
    rows = -(-len(projections) // per_row)
    with mpl.rc_context(STYLE):
        cell = (WIDTH - 0.9) / per_row
        size = WIDTH, rows * (0.88 * cell * height / width + 0.3) + 0.46
        figure = Figure(figsize=size, layout="constrained")
        edge = 0.08 / size[1]  # the layout of images of equal scales misses its pads by so much
        _pad(figure, h_pad=0.08, rect=(0, edge, 1, 1 - 2 * edge))
        grid = figure.subplots(rows, per_row, squeeze=False, sharex=True, sharey=True)
        for axes in grid.flat[len(projections) :]:
            axes.set_visible(False)
        for axes, (view, _), image in zip(grid.flat, projections, integrals, strict=False):
            axes.imshow(image, cmap="gray", norm=norm, origin="lower", extent=extent)
            axes.set_title(f"view {view}", loc="left")
            axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 4, 5, 10]))
            axes.yaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 4, 5, 10]))
        for axes in grid[-1]:
            axes.set_xlabel("u / mm", labelpad=1)
        for axes in grid[:, 0]:
            axes.set_ylabel("v / mm", labelpad=1)
        scale = ScalarMappable(norm, "gray")
        bar = figure.colorbar(scale, ax=grid, aspect=22 * rows, pad=0.01, extend="max")
        bar.set_label("−ln(I / I₀)")
        bar.outline.set_linewidth(0.5)
        return png(figure, 150)
