"""Shaded pictures of a specimen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.files.writing import complete
from twinct.specimen import _kernels
from twinct.specimen.build import BuiltSpecimen

VIEWS = {"front": (0.0, 0.0), "three-quarter": (35.0, 12.0), "side": (90.0, 0.0)}
"""Position of the viewer: degrees from +y (the face) towards +x, and above the horizon."""

COLOURS = ((0.90, 0.86, 0.76), (0.55, 0.63, 0.72), (0.80, 0.50, 0.40), (0.60, 0.72, 0.55))
LIGHT = (-0.45, 0.55, 0.70)
"""Direction to the light: right, up, towards the viewer."""


def shaded(
    specimen: BuiltSpecimen,
    azimuth_deg: float,
    elevation_deg: float,
    *,
    pixel_mm: float = 0.5,
    margin_mm: float = 8.0,
) -> NDArray[np.float32]:
    """Return an orthographic picture in the specimen's own frame; see ``VIEWS`` for the two angles.

    Returns:
        (rows, columns, 3) in [0, 1], row 0 on top, white background with an empty margin.
    """
    angles = np.radians([azimuth_deg, elevation_deg])
    (cos_a, cos_e), (sin_a, sin_e) = np.cos(angles), np.sin(angles)
    towards = np.array([sin_a * cos_e, cos_a * cos_e, sin_e])
    right = np.array([-cos_a, sin_a, 0.0])
    axes = np.stack([right, np.cross(towards, right), towards])
    low, high = specimen.bounds
    corners = np.array(np.meshgrid(*np.transpose([low, high]))).reshape(3, -1).T @ axes.T
    start, stop = corners.min(axis=0) - margin_mm, corners.max(axis=0) + margin_mm
    columns, rows = (int(np.ceil(n)) for n in (stop - start)[:2] / pixel_mm)

    depth = np.full((rows, columns), -np.inf)
    colour = np.ones((rows, columns, 3), dtype=np.float32)
    light = np.array(LIGHT) / np.linalg.norm(LIGHT)
    for index, part in enumerate(specimen.parts):
        across, up, near = (part.mesh.vertices @ axes.T).T
        points = np.stack([(across - start[0]) / pixel_mm, (stop[1] - up) / pixel_mm, near], axis=1)
        owner = np.full((rows, columns), -1, dtype=np.int64)
        weights = np.zeros((rows, columns, 3))
        faces = np.ascontiguousarray(part.mesh.faces, dtype=np.int64)
        _kernels.depth_buffer(points, faces, depth, owner, weights)
        hit = owner >= 0
        normals = _corner_normals(part.mesh.vertices, faces)[owner[hit]]
        normal = np.einsum("pc,pcd->pd", weights[hit], normals) @ axes.T
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        shade = 0.30 + 0.62 * np.clip(normal @ light, 0, 1) + 0.14 * np.clip(normal[:, 2], 0, 1)
        colour[hit] = shade[:, None] * np.array(COLOURS[index % len(COLOURS)])
    return _with_hollows_darkened(colour, depth, pixel_mm)


def preview_specimen(specimen: BuiltSpecimen, path_png: Path | str, title: str = "") -> None:
    """Write a picture from the front, three-quarter and side, with a scale in mm."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    extent = float((specimen.bounds[1] - specimen.bounds[0]).max())
    pixel = max(extent / 420, 1e-3)
    pictures = {
        name: shaded(specimen, *at, pixel_mm=pixel, margin_mm=0.04 * extent)
        for name, at in VIEWS.items()
    }
    tallest = max(len(picture) for picture in pictures.values())
    pictures = {name: _as_tall(picture, tallest) for name, picture in pictures.items()}
    widths = [picture.shape[1] for picture in pictures.values()]
    figure = Figure(figsize=(13, 5.2), facecolor="white")
    FigureCanvasAgg(figure)
    panels: Sequence = figure.subplots(1, len(pictures), width_ratios=widths)
    for panel, (name, picture) in zip(panels, pictures.items(), strict=True):
        rows, columns, _ = picture.shape
        half = (columns * pixel / 2, rows * pixel / 2)
        panel.imshow(picture, extent=(-half[0], half[0], -half[1], half[1]))
        bar = _round_length(0.3 * extent)
        panel.plot([-half[0], -half[0] + bar], [-half[1]] * 2, "k", lw=3, clip_on=False)
        panel.annotate(
            f"{bar:g} mm", (-half[0] + bar / 2, -half[1]), (0, -5), ha="center", va="top",
            textcoords="offset points", annotation_clip=False
        )  # fmt: skip
        panel.set_title(name)
        panel.set_axis_off()
    size = " x ".join(f"{edge:.1f}" for edge in specimen.bounds[1] - specimen.bounds[0])
    parts = ", ".join(
        f"{p.name} ({p.in_words}, {p.volume_mm3 / 1e3:.1f} cm3)" for p in specimen.parts
    )
    figure.suptitle(f"{title}\n" if title else "")
    figure.text(0.5, 0.02, f"{parts}; x, y, z: {size} mm", ha="center")
    with complete(Path(path_png)) as draft:
        figure.savefig(draft, dpi=110)


def _as_tall(picture: NDArray[np.float32], rows: int) -> NDArray[np.float32]:
    """Return the picture with white bars above and below."""
    lack = rows - len(picture)
    return np.pad(picture, ((lack // 2, lack - lack // 2), (0, 0), (0, 0)), constant_values=1.0)


def _corner_normals(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return normals (faces, 3 corners, 3): of the vertex if smooth there, else of the face."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    flat = np.cross(b - a, c - a)
    smooth = np.zeros_like(vertices)
    for i, d in np.ndindex(3, 3):
        smooth[:, d] += np.bincount(faces[:, i], flat[:, d], len(vertices))
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-30)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    corners = smooth[faces]
    sharp = np.einsum("fcd,fd->fc", corners, flat) < np.cos(np.radians(35))
    return np.where(sharp[..., None], flat[:, None], corners)


def _with_hollows_darkened(
    colour: NDArray[np.float32], depth: NDArray[np.float64], pixel_mm: float
) -> NDArray[np.float32]:
    """Darken pixels that lie behind their surroundings, as less light gets there."""
    from scipy.ndimage import gaussian_filter

    hit = np.isfinite(depth)
    if not hit.any():
        return colour
    filled = np.where(hit, depth, 0.0)
    for sigma_mm, strength in ((3.0, 0.05), (12.0, 0.022)):
        # Beyond a quarter of the picture, more takes long and changes little: in a picture of a
        # body of 1 mm, 12 mm would be 5,000 pixels.
        sigma = min(sigma_mm / pixel_mm, max(hit.shape) / 4)
        weight = gaussian_filter(hit.astype(float), sigma)
        around = gaussian_filter(filled, sigma) / np.maximum(weight, 1e-6)
        behind = np.clip(around - depth, 0, 40)
        factor = np.exp(-strength * np.where(hit, behind, 0.0))
        colour = colour * factor[..., None].astype(np.float32)
    return np.clip(colour, 0, 1)


def _round_length(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that does not exceed a length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))
