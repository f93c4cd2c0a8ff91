"""X-ray engine that intersects each ray with the triangles of the bodies."""

from collections.abc import Sequence

import numpy as np

from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.rays import Body, Rays
from twinct.xray.engine import EngineChoice, SceneBody


class Analytic:
    """X-ray engine that intersects each ray with the triangles of the bodies."""

    def prepare(self) -> None:
        """Nothing has to be loaded."""

    def acquire(self, bodies: Sequence[SceneBody], panel: Panel) -> None:
        self._bodies = [Body(body.vertices, body.faces) for body in bodies]
        self._mu = [body.mu_per_mm for body in bodies]

    def render(self, view: ScanGeometry, image: np.ndarray) -> None:
        lengths = np.empty_like(image)
        image[:] = 0
        for body, mu in enumerate(self._mu):
            self.path_lengths(view, body, lengths)
            image -= np.float32(mu) * lengths
        np.exp(image, out=image)

    def path_lengths(self, view: ScanGeometry, body: int, lengths: np.ndarray) -> None:
        shadow = Rays(view).shadow(self._bodies[body], Pose.identity(), 0)
        lengths[:] = 0
        lengths[shadow.box.rows, shadow.box.columns] = shadow.lengths

    def release(self) -> None:
        self._bodies = []


ANALYTIC = EngineChoice("analytic", Analytic())
