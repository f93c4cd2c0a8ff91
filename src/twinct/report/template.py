"""Parts of all pages: rendering, and the format of numbers and durations."""

from __future__ import annotations

from typing import Any


def rendered(template: str, **values: Any) -> str:
    """Return a page as HTML text: images inline, no script, no external resources."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("twinct.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"fixed": fixed, "duration": duration}
    return environment.get_template(template).render(values)


def fixed(value: float | None, digits: int = 2, factor: float = 1.0) -> str:
    """Format a number with a fixed count of digits; a dash stands for None."""
    return "–" if value is None else f"{factor * value:z.{digits}f}"


def duration(seconds: float | None) -> str:
    """Format a duration in seconds, minutes or hours, whichever reads best."""
    if seconds is None:
        return "–"
    if seconds < 100:
        return f"{seconds:.1f} s"
    if seconds < 6000:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"
