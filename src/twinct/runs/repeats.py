"""Repetitions of a scan, with noise of their own or with signals inserted, and their volumes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twinct.evaluation import Again, Repeated
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.observers import Audience
from twinct.runs.volumes import reconstruct
from twinct.scan import Scan, SimulationBuilder
from twinct.specimen.signals import GaussianSignal, Inserts, SphereSignal
from twinct.xray.build import effective_energy_kev

Volume = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Repeats:
    """Repetitions of one scan; each image is made once, and each volume once per geometry.

    A repetition has the poses, the flat and the dark images of the scan. A signal is inserted by
    what it takes from the light of each pixel (projection domain: B. Chen et al., Med. Phys. 42
    (2015) 7034), so that the noise stays: of a weak signal, the small change of the photons' number
    is left out.

    Attributes:
        scan: the scan.
        builder: parts of its scenario.
        audience: notified of the stages.
    """

    scan: Scan
    builder: SimulationBuilder
    audience: Audience = field(default_factory=Audience)
    _images: dict[int, Volume] = field(default_factory=dict[int, Volume], init=False, repr=False)
    _volumes: dict[tuple[str, int], Volume] = field(
        default_factory=dict[tuple[str, int], Volume], init=False, repr=False
    )

    def of(self, which: str, first: Volume) -> Again:
        """Return what repeats the volume of a geometry.

        Args:
            which: name of the geometry.
            first: volume of the scan itself from this geometry, (z, y, x), 1/mm.
        """

        def again(
            signal: SphereSignal | GaussianSignal, centres_mm: Floats, scans: int
        ) -> Repeated:
            inserted = self._inserted(signal, centres_mm)
            others = range(1, scans if self._noisy else 1)
            self._take(others)
            with self.audience.stage(f"detectability, {which} geometry", 1 + len(others)) as step:
                seen = self._reconstructed(self.scan.transmission * inserted, which)
                step()
                without = [first]
                for number in others:
                    key = which, number
                    if key not in self._volumes:
                        self._volumes[key] = self._reconstructed(self._images[number], which)
                    without.append(self._volumes[key])
                    step()
            return Repeated(without, seen)

        return again

    @property
    def _noisy(self) -> bool:
        detector = self.scan.scenario.detector
        readout = detector.readout
        return detector.noise is not None or (readout is not None and readout.electronic_noise > 0)

    def _reconstructed(self, transmission: Volume, which: str) -> Volume:
        return reconstruct(replace(self.scan, transmission=transmission), geometry=which).array

    def _inserted(self, signal: SphereSignal | GaussianSignal, centres_mm: Floats) -> Volume:
        scenario, specimen = self.scan.scenario, self.builder.specimen
        mu = specimen.reference_mu(effective_energy_kev(scenario.source, scenario.detector))
        inserts = Inserts(signal, self.scan.simulated.stands.inverse().apply(centres_mm), mu)
        with (
            self.audience.stage("images with the signal", len(self.scan)) as step,
            self.builder.imager() as imager,
        ):
            shares = np.empty_like(self.scan.transmission)
            for view, path, before in self._exposures():
                shares[view] = imager.inserted(path, view, inserts, before)
                step()
        return shares

    def _take(self, numbers: range) -> None:
        """Take the images of repetitions that there are not yet."""
        missing = [number for number in numbers if number not in self._images]
        if not missing:
            return
        with (
            self.audience.stage("images with other noise", len(self.scan)) as step,
            self.builder.imager() as imager,
        ):
            for number in missing:
                self._images[number] = np.empty_like(self.scan.transmission)
            for view, path, before in self._exposures():
                taken = imager.repeated(path, view, before, repetitions=missing)
                for number, image in zip(missing, taken, strict=True):
                    self._images[number][view] = image
                step()

    def _exposures(self) -> Iterator[tuple[int, PosePairs, PosePairs | None]]:
        """Yield each view with the poses of its exposure, and those before it if they lag."""
        taken, lags = self.scan.simulated, self.scan.scenario.detector.lag > 0
        executed = replace(taken.executed, object=taken.executed_object)
        for view in range(len(self.scan)):
            path = taken.exposure[view] if taken.exposure else executed[view : view + 1]
            yield view, path, executed[view - 1 : view] if lags and view else None
