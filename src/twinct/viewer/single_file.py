"""A single-file page that plays all views with a free camera, without server or network."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from twinct.core.files.writing import MADE_BY, storage_errors, write_text
from twinct.core.progress import Progress
from twinct.scan import SimulationBuilder
from twinct.viewer.curves import Chart, curves
from twinct.viewer.filling import specimen_as_it_looks, whole_room
from twinct.viewer.planned import field_of_view
from twinct.viewer.scenery import see_whole_room, set_lights
from twinct.viewer.server import LOOPBACK, close, serve
from twinct.viewer.show import Show
from twinct.viewer.stage import NOTHING, Look, Stage
from twinct.viewer.surface import dense_surface
from twinct.viewer.tiles import slices_beside

VIEWS_A_SECOND = 10

SURFACE_TRIANGLES = 40_000


def export_page(
    show: Show, builder: SimulationBuilder | None, path: Path, progress: Progress
) -> None:
    """Write a scan, or a plan, as a single-file page.

    It shows the middle slices. Curves and the slices of all volumes are embedded as pictures.

    Raises:
        InputError: the scenario's room cannot be built.
        StorageError: the file cannot be written.
    """
    server = serve(LOOPBACK, 0)
    try:
        set_lights(server)
        see_whole_room(server, show)
        stage = Stage(server, "run", np.zeros(3))
        if (room := whole_room(show, builder)) is not None:
            stage.set_room(show, room)
        look = first_look(show)
        if show.volumes:
            volume, level = show.volumes[show.main_volume], 0.5 * show.window()[1] / 1.3
            stage.set_surface(
                dense_surface(volume.array, volume.grid, level, SURFACE_TRIANGLES), opacity=0.35
            )
        elif builder is not None:
            stage.set_specimen(specimen_as_it_looks(builder.specimen))
            stage.set_field_of_view(field_of_view(show))
        stage.draw(show, look, None)
        serializer = server.get_scene_serializer()
        with progress.stage("page", len(show)) as step:
            for view in range(len(show)):
                now = replace(look, view=view)
                if view:
                    stage.draw(show, now, look)
                look = now
                serializer.insert_sleep(1.0 / VIEWS_A_SECOND)
                step()
        text = serializer.as_html()
    finally:
        close(server)
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, _with_pictures(text, show, look))


def first_look(show: Show) -> Look:
    """Return the initial look at a run, with slices through the middle."""
    shown = show.main_volume or NOTHING
    nx, ny, nz = show.volumes[shown].grid.shape_xyz if show.volumes else (2, 2, 2)
    geometry = show.kept if show.acquired else show.first_name
    middle = nx // 2, ny // 2, nz // 2
    return Look(geometry=geometry, shown=shown, slices=middle, window=show.window())


def _with_pictures(text: str, show: Show, look: Look) -> str:
    """Return the page with its title, and with pictures that unfold in a corner."""
    pictures = []
    if (sheet := slices_beside([show], look)) is not None:
        pictures.append(("slices", _png(sheet)))
    if shown_curves := curves([show]):
        pictures.append(("curves", curves_picture(shown_curves)))
    parts = [
        f"<details><summary>{name}</summary>"
        f'<img alt="{name}" src="data:image/png;base64,{base64.b64encode(content).decode()}">'
        "</details>"
        for name, content in pictures
    ]
    box = (
        "<style>#twinct{position:fixed;top:.6em;left:.6em;z-index:50;max-height:85vh;overflow:auto;"
        "background:#ffffffe8;padding:.5em .8em;border-radius:.4em;font:14px sans-serif;"
        "color:#1f2933;box-shadow:0 1px 4px #0003}#twinct img{max-width:38vw;display:block}"
        "#twinct summary{cursor:pointer}</style>"
        f'<div id="twinct"><b>{html.escape(show.name)}</b><br>{html.escape(show.state)}'
        f"{''.join(parts)}</div>"
    )
    end = text.rindex("</body>")
    named = text[:end] + box + text[end:]
    named = named.replace("<head>", f"<head>{MADE_BY}", 1)
    start, stop = named.index("<title>") + 7, named.index("</title>")
    return f"{named[:start]}{html.escape(show.name)} - twinct{named[stop:]}"


def curves_picture(shown_curves: Sequence[Chart]) -> bytes:
    """Return a picture (PNG) of all curves, one below the other."""
    figure = Figure(figsize=(6.0, 2.4 * len(shown_curves)), layout="constrained", dpi=110)
    panels = np.atleast_1d(figure.subplots(len(shown_curves), 1))
    for axes, curve in zip(panels, shown_curves, strict=True):
        for name, values in curve.series.items():
            axes.plot(curve.x, values, label=name, linewidth=1)
        axes.set_title(curve.title, fontsize=9)
        axes.set_xlabel("view" if curve.over_views else "iteration", fontsize=8)
        axes.tick_params(labelsize=8)
        axes.legend(fontsize=7)
    picture = io.BytesIO()
    with closing(picture):
        FigureCanvasAgg(figure).print_png(picture)
        return picture.getvalue()


def _png(pixels: np.ndarray) -> bytes:
    picture = io.BytesIO()
    Image.fromarray(pixels).save(picture, format="PNG", optimize=True)
    return picture.getvalue()
