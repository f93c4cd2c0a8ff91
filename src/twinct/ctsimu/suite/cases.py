"""Scenarios of all qualification tests, with the samples of ``samples``.

The geometry of 2D-FB, 2D-DW and 2D-WE is the one that the toolbox uses in its evaluation. BAM's
tube spectra are not public: ours are SpekPy's, for the same voltage and window.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimesh import Trimesh

from twinct.core.files.writing import write_json
from twinct.ctsimu.suite import samples
from twinct.ctsimu.writing import Json, header, material_entry, placed, quantity, sample, write_mesh

DENSITY_G_CM3 = dict(
    Al=2.6989, Fe=7.874, Ti=4.54, Cu=8.92, Pt=21.45, W=19.25, CsI=4.51, Gd2O2S=7.34
)
OPAQUE = "opaque"
OPAQUE_G_CM3 = 1e7
"""Density of tungsten so high that 0.01 mm is opaque."""

COVERAGE_SAMPLES = 20
"""Rays along a pixel's edge in 2D-WE-2.

The test counts every pixel that the edge cuts, however small the part. The default of 3 detects
about two thirds, and fails.
"""

WEDGE_PANEL_MM, WEDGE_PITCH_MM = 1000.0, 0.2


@dataclass(frozen=True)
class Piece:
    """Placed sample: its mesh is in the world."""

    name: str
    mesh: Callable[[], Trimesh]
    material: str


@dataclass(frozen=True)
class Case:
    """One rendering that a test needs.

    Attributes:
        key: the toolbox's name of the sub-test; empty if there is only one.
        panel_mm: distance from the source to the panel.
        voltage_kv: tube voltage; the energy in keV if monochromatic.
        copper_mm: thickness of the copper filter.
        parts: samples; the later one counts where two overlap.
        scintillator: material and thickness in mm of a real detector.
        snr: signal-to-noise ratio of one frame in the free beam.
        spot_mm: sigma of a Gaussian focal spot.
        samples: rays along each pixel edge.
    """

    test: str
    key: str
    columns: int
    rows: int
    pitch_mm: float
    panel_mm: float
    voltage_kv: float
    monochromatic: bool = False
    copper_mm: float = 0.0
    parts: Sequence[Piece] = ()
    scintillator: tuple[str, float] | None = None
    snr: float | None = None
    resolution_mm: float | None = None
    spot_mm: float = 0.0
    flat: bool = True
    samples: int = 3
    spot_points: int = 32

    @property
    def name(self) -> str:
        """Stem of the file names."""
        return f"{self.test}_{self.key}" if self.key else self.test

    def write(self, folder: Path) -> Path:
        """Write the samples and the scenario file, and return its path."""
        folder.mkdir(parents=True, exist_ok=True)
        entries = []
        for part in self.parts:
            file = folder / f"{self.name}_{part.name}.obj"
            position = placed(write_mesh(part.mesh(), file), (1, 0, 0), (0, 0, 1), "rt")
            entries.append(sample(part.name, file, part.material, position))
        path = folder / f"{self.name}.json"
        write_json(path, self._scenario(entries))
        return path

    def _scenario(self, entries: list[Json]) -> Json:
        still = {"deviations": []}
        spot = {axis: quantity(self.spot_mm, "mm") for axis in "uv"} | {"w": quantity(0.0, "mm")}
        copper = [{"material_id": "Cu", "thickness": quantity(self.copper_mm, "mm")}]
        layer = None
        if self.scintillator is not None:
            name, thickness = self.scintillator
            layer = {"material_id": name, "thickness": quantity(thickness, "mm")}
        materials = [material_entry(n, d, {n: 1.0}) for n, d in DENSITY_G_CM3.items()]
        return {
            "file": header(self.name, f"CTSimU qualification test {self.name}"),
            "environment": {"material_id": None},
            "geometry": {
                "detector": placed((self.panel_mm, 0, 0), (0, -1, 0), (1, 0, 0)),
                "source": {"type": "cone"} | placed((0, 0, 0), (0, -1, 0), (1, 0, 0)),
                "stage": placed((self.panel_mm / 2, 0, 0), (1, 0, 0), (0, 0, 1)) | still,
            },
            "detector": {
                "type": "ideal" if layer is None else "real",
                "columns": quantity(self.columns, "px"),
                "rows": quantity(self.rows, "px"),
                "pixel_pitch": {axis: quantity(self.pitch_mm, "mm") for axis in "uv"},
                "bit_depth": quantity(16),
                "integration_time": quantity(1.0, "s"),
                "gray_value": {"imax": quantity(60000), "imin": quantity(0)},
                "noise": {"snr_at_imax": quantity(self.snr)},
                "unsharpness": {"basic_spatial_resolution": quantity(self.resolution_mm, "mm")},
                "scintillator": layer,
            },
            "source": {
                "voltage": quantity(self.voltage_kv, "kV"),
                "current": quantity(100.0, "uA"),
                "target": {
                    "material_id": "W",
                    "type": "reflection",
                    "angle": {k: quantity(45.0, "deg") for k in ("incidence", "emission")},
                },
                "spot": {"sigma": spot},
                "spectrum": {"monochromatic": self.monochromatic, "file": None},
                "window": [{"material_id": "Al", "thickness": quantity(4.0, "mm")}],
                "filters": copper if self.copper_mm else [],
            },
            "samples": entries,
            "acquisition": {
                "start_angle": quantity(0.0, "deg"),
                "stop_angle": quantity(0.0, "deg"),
                "direction": "CCW",
                "scan_mode": "stop+go",
                "number_of_projections": 1,
                "include_final_angle": False,
                "frame_average": 1,
                "dark_field": {"number": 0},
                "flat_field": {"number": int(self.flat), "frame_average": 1, "ideal": True},
                "scattering": False,
            },
            "materials": [*materials, material_entry(OPAQUE, OPAQUE_G_CM3, {"W": 1.0})],
        }


def cases(tests: Sequence[str]) -> list[Case]:
    """Return all renderings that the given tests need, in their order."""
    return [case for test in tests for case in _CASES[test]()]


def _free_beams() -> list[Case]:
    shared: dict[str, Any] = {"columns": 1000, "rows": 1000, "pitch_mm": 0.1, "panel_mm": 10000.0}
    return [
        Case("2D-FB-1", f"SNR{snr}", **shared, voltage_kv=150.0, snr=snr, flat=False)
        for snr in (100, 250)
    ]


def _distance() -> list[Case]:
    return [Case("2D-FB-2", "", 501, 501, 0.4, 30.0, 150.0, flat=False)]


def _edge(distance_mm: float = 500.0) -> Piece:
    return Piece("edge", lambda: samples.edge(distance_mm), OPAQUE)


def _spots() -> list[Case]:
    return [
        Case(
            "2D-WE-1", key, 1001, 1001, 0.008, 1000.0, 150.0,
            parts=[_edge()], spot_mm=sigma_mm, spot_points=100
        )
        for key, sigma_mm in (("spot1", 0.008), ("spot2", 0.024))
    ]  # fmt: skip


def _coverage() -> list[Case]:
    return [
        Case(
            "2D-WE-2", "", 1001, 1001, 0.008, 1000.0, 50.0,
            monochromatic=True, parts=[_edge()], samples=COVERAGE_SAMPLES
        )
    ]  # fmt: skip


def _wires() -> list[Case]:
    pitch = 0.05
    middle = ((1126 - 1000) * pitch, (496 - 500) * pitch)
    part = Piece("wires", lambda: samples.duplex_wires(1000.0, middle, 1050 * pitch), "Pt")
    return [
        Case(
            "2D-DW-1", key, 2000, 1000, pitch, 1000.0, 220.0,
            copper_mm=2.0, parts=[part], resolution_mm=resolution_mm, samples=4
        )
        for key, resolution_mm in (("SR75", 0.075), ("SR150", 0.15))
    ]  # fmt: skip


def _wedge(name: str, of: str, **ends: Any) -> Piece:
    steps = samples.IRON_STEPS_MM if of == "Fe" else samples.WEDGE_STEPS_MM
    return Piece(
        name, lambda: samples.wedge(WEDGE_PANEL_MM, WEDGE_PITCH_MM, steps_mm=steps, **ends), of
    )


def _wedge_case(test: str, key: str, parts: list[Piece], voltage_kv: float, **more: Any) -> Case:
    size = samples.WEDGE_PANEL_PX
    return Case(
        test, key, size, size, WEDGE_PITCH_MM, WEDGE_PANEL_MM, voltage_kv, parts=parts, **more
    )


def _scintillators() -> list[Case]:
    detectors = (("D1", None), ("D2", ("CsI", 0.2)), ("D3", ("CsI", 0.5)), ("D4", ("Gd2O2S", 0.5)))
    beams = (("Al", 50, True), ("Al", 120, False), ("Fe", 100, True), ("Fe", 200, False))
    return [
        _wedge_case(
            "2D-SW-1", f"{detector}_{of}_{voltage}", [_wedge("wedge", of)], float(voltage),
            monochromatic=mono, scintillator=layer, samples=1
        )
        for detector, layer in detectors
        for of, voltage, mono in beams
    ]  # fmt: skip


def _filters() -> list[Case]:
    return [
        _wedge_case(
            "2D-SW-2", f"{of}{'Cu' if copper else ''}", [_wedge("wedge", of)], 200.0,
            copper_mm=copper, samples=1
        )
        for of in ("Al", "Fe")
        for copper in (0.0, 2.0)
    ]  # fmt: skip


def _overlaps() -> list[Case]:
    joint = samples.WEDGE_JOINT_PX

    def bevel(y: float) -> float:
        return joint - samples.overlap_px(y) + samples.gap_px(y)

    return [
        _wedge_case(
            "2D-SW-3", f"Al_{of}",
            [_wedge("left", "Al", right=lambda y: joint), _wedge("right", of, left=bevel)],
            80.0, monochromatic=True, samples=4
        )
        for of in ("Al", "Ti")
    ]  # fmt: skip


_CASES: dict[str, Callable[[], list[Case]]] = {
    "2D-FB-1": _free_beams,
    "2D-FB-2": _distance,
    "2D-DW-1": _wires,
    "2D-WE-1": _spots,
    "2D-WE-2": _coverage,
    "2D-SW-1": _scintillators,
    "2D-SW-2": _filters,
    "2D-SW-3": _overlaps,
}

TESTS = tuple(_CASES)
"""Names of the supported tests."""

NOT_TAKEN = {
    "2D-HS-1": "the foil of ten holes that it images is not public, and its sizes are not stated",
    "2D-SW-4": "it judges scattered radiation, and files that ask for it are refused",
}
"""Other 2D tests of the suite, with the reasons to leave them out."""
