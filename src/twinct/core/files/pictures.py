"""Pictures of matplotlib on the screen, in a notebook or in a file."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.files.writing import complete, storage_errors


def show(
    draw: Callable[[Any], None], size_inch: tuple[float, float], to: str | Path | BytesIO | None
) -> None:
    """Draw a figure and show it, or write it to a file.

    Args:
        draw: receives the empty ``Figure``.
        size_inch: width and height.
        to: file, whose ending names the format; a buffer for PNG; None for the screen or the
            notebook.

    Raises:
        InputError: nothing can be shown here, or matplotlib does not know the file's ending.
        StorageError: the file cannot be written.
    """
    if to is None:
        _on_screen(draw, size_inch)
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inch, layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    draw(figure)
    if isinstance(to, BytesIO):
        canvas.print_png(to)
        return
    path = Path(to)
    known = canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in known:
        raise InputError(
            f"{path}: the name of a picture must end in one of .{', .'.join(sorted(known))}"
        )
    with storage_errors(path), complete(path) as draft:
        figure.savefig(draft)


def _on_screen(draw: Callable[[Any], None], size_inch: tuple[float, float]) -> None:
    import matplotlib as mpl
    from matplotlib import pyplot

    # matplotlib chooses a backend that draws to memory if there is no display.
    if pyplot.get_backend().lower() in {"agg", "cairo", "pdf", "pgf", "ps", "svg", "template"}:
        raise InputError(
            f"no window can show a picture here (matplotlib's backend is {mpl.get_backend()}): "
            "name a file, such as show('picture.png')"
        )
    draw(pyplot.figure(figsize=size_inch, layout="constrained"))
    pyplot.show()


def notebook_widgets() -> Any:
    """Return the module ``ipywidgets`` in a notebook that has it; else None."""
    shell = sys.modules.get("IPython")
    session = shell.get_ipython() if shell is not None else None
    if getattr(session, "kernel", None) is None or not importlib.util.find_spec("ipywidgets"):
        return None
    return importlib.import_module("ipywidgets")
