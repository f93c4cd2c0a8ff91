"""The folder of the beam: spectrum, tube load, exposure, noise and scatter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from twinct.design import beam_keys
from twinct.design.page.tools import Tool, Tools
from twinct.scenario import Scenario


class BeamFolder(Tool):
    """Source and signal of the panel."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the folder."""
        super().__init__(tools)
        gui = tools.server.gui
        with gui.add_folder("X-rays", order=order, expand_by_default=False):
            self._spectrum: Any = gui.add_dropdown(
                "spectrum", (beam_keys.MONOCHROMATIC, beam_keys.TUBE)
            )
            self._energy = gui.add_number("photon energy, keV", 80.0, min=5, max=500)
            self._voltage = gui.add_number("tube voltage, kV", 120.0, min=20, max=300)
            self._mas = gui.add_number(
                "tube load, mAs a view", 0.01, min=1e-6, step=1e-6, hint="Changes the current."
            )
            self._exposure = gui.add_number("exposure, ms", 10.0, min=0.001, max=60_000)
            self._noise = gui.add_checkbox(
                "noise", False, hint="Needs a tube, or source.photons_per_mm2_mas."
            )
            self._scatter = gui.add_checkbox("scatter", False)
        tools.on(self._spectrum, "spectrum", self._does(beam_keys.of_spectrum))
        for handle, of in (
            (self._energy, beam_keys.of_energy),
            (self._voltage, beam_keys.of_energy),
            (self._mas, beam_keys.of_mas),
            (self._exposure, beam_keys.of_exposure),
            (self._noise, beam_keys.of_noise),
            (self._scatter, beam_keys.of_scatter),
        ):
            tools.on(handle, ("beam", handle.label), self._does(of, handle))

    def _does(self, of: Callable[[Scenario, Any], beam_keys.Values], *by: Any) -> Any:
        def change(value: Any) -> None:
            if self.tools.shown is not None:
                self.tools.change(of(self.tools.shown, value), of, by)

        return change

    def paint(self, scenario: Scenario) -> None:
        """Show source and signal."""
        spectra, kind = beam_keys.spectra(scenario), beam_keys.spectrum_of(scenario)
        if self._spectrum.options != spectra:
            self._spectrum.options = spectra
        known = beam_keys.energy_of(scenario)
        for handle, shown in (
            (self._energy, kind == beam_keys.MONOCHROMATIC),
            (self._voltage, kind == beam_keys.TUBE),
        ):
            handle.visible = shown
            if shown and known is not None:
                self.put(handle, known[1])
        source, detector = scenario.source, scenario.detector
        self.put(self._spectrum, kind)
        self.put(self._mas, source.mas)
        self.put(self._exposure, source.exposure_ms)
        self.put(self._noise, detector.noise is not None)
        self.put(self._scatter, detector.scatter is not None)
