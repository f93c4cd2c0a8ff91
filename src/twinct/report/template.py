"""What all pages share: their style, and how numbers and durations are written."""

from __future__ import annotations

from typing import Any


def rendered(template: str, **values: Any) -> str:
    """A page as HTML text: images inline, no script, nothing loaded from elsewhere."""
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
    """A number with a fixed count of digits, or a dash where there is none."""
    return "–" if value is None else f"{factor * value:z.{digits}f}"


def duration(seconds: float | None) -> str:
    """Seconds, minutes or hours, whichever reads best."""
    if seconds is None:
        return "–"
    if seconds < 100:
        return f"{seconds:.1f} s"
    if seconds < 6000:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"
