"""All error terms by name, built in or from extensions."""

from __future__ import annotations

from typing import Any

from twinct.uncertainty.error_terms import ErrorSettings, ErrorTerm
from twinct.uncertainty.sections import Uncertainty, error_terms
from twinct.uncertainty.terms.displacements import AGEING, BASE, JOINT_OFFSET, LINK, TOOL
from twinct.uncertainty.terms.drift import DRIFT
from twinct.uncertainty.terms.gear import GEAR
from twinct.uncertainty.terms.rail import RAIL
from twinct.uncertainty.terms.servo import CLOCK, VIBRATION
from twinct.uncertainty.terms.trigger import TRIGGER
from twinct.uncertainty.terms.views import VIEWS
from twinct.uncertainty.terms.windup import WINDUP

BUILT_IN: dict[str, ErrorTerm] = {
    term.name: term
    for term in (
        *(JOINT_OFFSET, LINK, BASE, TOOL, AGEING, DRIFT, WINDUP, GEAR, TRIGGER, RAIL),
        *(VIBRATION, CLOCK, VIEWS),
    )
}
"""Terms of this package; deviations of the joints add up in this order."""


def terms_of(uncertainty: Uncertainty, side: str) -> list[tuple[ErrorTerm, Any]]:
    """Return the terms that make executed poses of one side deviate, each with its settings."""
    terms: list[tuple[ErrorTerm, Any]] = []
    for term in (*BUILT_IN.values(), *error_terms().values()):
        settings: ErrorSettings | None = getattr(uncertainty, term.section or term.name, None)
        own = None if settings is None else settings.of(side)
        if own is not None and any(own.sizes):
            terms.append((term, own))
    return terms
