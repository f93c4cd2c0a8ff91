"""Dynamics of an arm that its encoders do not see: vibration of the joints, and a clock apart."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from twinct.geometry import Floats
from twinct.uncertainty.error_terms import ErrorTerm, Spread, ToolMotion
from twinct.uncertainty.sections import ArmServo

REST = 1e-3
"""Share of a vibration's amplitude at which its memory ends."""

STEPS = 40
"""Instants for each period, at which the integral over past accelerations is evaluated.

With 40, a constant acceleration bends a joint by 0.14 % too little; with 20, by 0.8 %.
"""

S_PER_MS, PER_PPM = 1e-3, 1e-6


def bent(servo: ArmServo, motion: ToolMotion) -> Floats:
    """Return the angles by which the joints lag behind their encoders, (views, joints), rad.

    A joint behind its encoder is a damped oscillator, d'' + 2 z w d' + w^2 d = -a, that the
    encoder's acceleration a drives: d(t) is minus the integral of a(t - s) over the response
    exp(-z w s) sin(w1 s) / w1, with w1^2 = w^2 (1 - z^2).
    """
    assert motion.accelerations is not None
    omega = 2 * np.pi * servo.resonance_hz
    ringing = omega * np.sqrt(1 - servo.damping**2)
    memory_s = -np.log(REST) / (servo.damping * omega)
    past = np.linspace(0, memory_s, int(np.ceil(memory_s * servo.resonance_hz * STEPS)) + 1)
    response = np.exp(-servo.damping * omega * past) * np.sin(ringing * past) / ringing
    weights = response * past[1]
    angles = [weights @ motion.accelerations(now - past) for now in motion.time_s]
    return -np.array(angles) * (1 if motion.chain is None else motion.chain.hinges)


def _vibration(servo: ArmServo, motion: ToolMotion) -> Iterator[Spread]:
    if motion.chain is not None and motion.accelerations is not None and servo.resonance_hz:
        yield Spread("joints", bent(servo, motion), draws="none")


def _clock(servo: ArmServo, motion: ToolMotion) -> Iterator[Spread]:
    if motion.chain is not None and (servo.clock_ms or servo.clock_ppm):
        # The arm does late what its clock says, so that the image shows it where it was before.
        late_s = servo.clock_ms * S_PER_MS + servo.clock_ppm * PER_PPM * motion.time_s
        yield Spread("joints", -late_s[:, None] * motion.speeds, draws="none")


def _no_prior(section: Any) -> dict[str, Floats]:
    return {}


VIBRATION = ErrorTerm("vibration", ArmServo, _vibration, ("joints",), "servos", prior=_no_prior)
CLOCK = ErrorTerm("clock", ArmServo, _clock, ("joints",), "servos", prior=_no_prior)
