"""The question for the scatter in one view, by few photons, which is added to the preview."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar

from twinct.core.errors import InputError
from twinct.design.bench import Bench
from twinct.design.questions import Image, Projection, Question, preview
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario

if TYPE_CHECKING:
    from twinct.transport import VoxelBody
    from twinct.xray.chain import ImagingChain

PHOTONS = 200_000
"""Photons of a view: line integrals of demo and patient_head get an error of 0.010 and 0.016 (rms),
less than a grey level of a picture with 256 of them from 0 to 5."""


def faint(scenario: Scenario) -> Scenario:
    """Return the scenario of the preview with scatter of few photons, and what it passes."""
    seen, detector = preview(scenario), scenario.detector
    if detector.scatter is None:
        raise InputError("detector.scatter: null; there is no scatter to show")
    few = min(PHOTONS, detector.scatter.photons)
    keys = {
        "scatter": detector.scatter.model_copy(update={"photons": few}),
        "grid": detector.grid,
        "response": detector.response,
    }
    return seen.model_copy(update={"detector": seen.detector.model_copy(update=keys)})


@dataclass(frozen=True, eq=False)
class ScatterOfViews:
    """Scatter of a scenario's specimen in its requested views; those that were asked for are kept.

    Attributes:
        builder: parts of a scenario of ``faint``.
        body: the specimen in voxels.
        chain: source and detector.
    """

    builder: SimulationBuilder
    body: VoxelBody
    chain: ImagingChain
    _images: dict[int, Image] = field(default_factory=dict[int, Image])

    @classmethod
    def of(cls, builder: SimulationBuilder) -> ScatterOfViews:
        """Prepare the specimen and the beam.

        Raises:
            InputError: there are too many voxels.
        """
        from twinct.xray.chain import ImagingChain
        from twinct.xray.monte_carlo_scatter import body_of

        scenario, specimen = builder.scenario, builder.specimen
        assert scenario.detector.scatter is not None
        materials = tuple(dict.fromkeys(one for part in specimen.parts for one in part.materials))
        chain = ImagingChain(scenario.source, scenario.detector, materials, builder.requested)
        return cls(builder, body_of(scenario.detector.scatter, specimen), chain)

    def image(self, view: int) -> Image:
        """Return the scatter as a share of the free beam, (rows, columns).

        Raises:
            InputError: a photon energy is outside the tables.
        """
        if view not in self._images:
            self._images[view] = self._simulated(view)
        return self._images[view]

    def _simulated(self, view: int) -> Image:
        from twinct.xray.build import build_panel_response
        from twinct.xray.monte_carlo_scatter import ScatterNodes

        detector, seen = self.builder.scenario.detector, self.builder.requested[view]
        assert detector.scatter is not None
        own = self.builder.specimen.world_from_specimen.inverse() @ seen
        chain = self.chain
        nodes = ScatterNodes(
            *(self.body, own, chain.beam, build_panel_response(detector), chain.grid),
            detector.scatter,
        )
        expected = chain.blank()
        chain.add_scatter(nodes.image(own), expected)
        return chain.frame(expected, chain.physical(seen), view).transmission


@dataclass(frozen=True)
class Scatter(Question):
    """The scatter in one view, as a share of the free beam, on the pixels of the preview.

    Attributes:
        view: index of the view.
    """

    view: int = 0
    subject: ClassVar[str] = "scatter"
    reads = staticmethod(Projection.reads)

    def answered(self, bench: Bench) -> Image:
        """Return the scatter, (rows, columns).

        Raises:
            InputError: the scenario has no scatter, or it cannot be simulated.
        """
        scenario = bench.scenario(self.source)
        builder = bench.builder(scenario)
        of_views = bench.kept("scatter", self.reads(scenario), lambda: _of(builder))
        return of_views.image(min(self.view, len(of_views.builder.requested) - 1))


def _of(builder: SimulationBuilder) -> ScatterOfViews:
    small = replace(builder, scenario=faint(builder.scenario), given_specimen=builder.specimen)
    return ScatterOfViews.of(small)
