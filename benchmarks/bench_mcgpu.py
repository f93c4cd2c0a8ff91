"""Images of scatter against MC-GPU 1.3, on one thread each.

    python benchmarks/bench_mcgpu.py radiograph --binary mcgpu --water water.mcgpu
    python benchmarks/bench_mcgpu.py speed --binary mcgpu --water water.mcgpu
    python benchmarks/bench_mcgpu.py cylinders --binary mcgpu --water water.mcgpu

``radiograph``: a cube of water of 200 mm and a panel of 400 mm, at 60 keV and 120 kVp; each order
of scatter in each of 25 regions, relative to the whole signal there. ``speed``: variance times
processor time in these regions, relative to MC-GPU's, from 40 seeds with a tenth of the photons.
``cylinders``: scatter to primary behind the middle of cylinders of water. ``--coefficients own``
gives MC-GPU our mean free paths, so that the transport alone differs.

MC-GPU (Badal, Badano, Med. Phys. 36 (2009) 4878; github.com/DIDSR/MCGPU) counts the photons that
reach the panel, without forcing. A binary for one thread comes from

    gcc -x c -O3 -march=native -ffast-math -funroll-loops -fgnu89-inline MC-GPU_v1.3.cu -lm -lz

and a file of water from github.com/DIDSR/MCGPUv1.3_PCD (Sample_Fan_Beam/inputs).
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.threads import limit_threads
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.specimen.materials import Material, material
from twinct.transport import ORDERS, Beam, Detector, Simulation, VoxelBody
from twinct.transport.cross_sections import COMPTON, RAYLEIGH, TOTAL, energies_kev, media_tables
from twinct.xray.tube import tube_spectrum

WATER = material("water")
VACUUM = Material("vacuum", 2e-9, WATER.mass_fractions)
"""MC-GPU refuses densities below 1e-9 g/cm^3."""

SOURCE_MM, PANEL_MM = 600.0, 400.0
"""From the middle of the body to the focal spot and to the panel."""

KINDS = ("primary", *ORDERS)
MOST = 0.03
SEEDS, SEEDS_OF_SPEED = 5, 40
RADII_MM = (25, 50, 75, 100)
TUBES_KV = (60, 90, 120)

Images = NDArray[np.float64]
Run = Callable[[int], tuple[Images, float]]
"""Images of a seed, keV a photon, (4, rows, columns); and their processor seconds."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Water in a cone beam along y that covers just the panel; energies in keV."""

    name: str
    grid: VolumeGrid
    water: NDArray[np.bool_]
    panel: Panel
    energies: NDArray[np.float64]
    photons: NDArray[np.float64]

    @cached_property
    def simulation(self) -> Simulation:
        """Our simulation of it."""
        body = VoxelBody.of_labels(self.grid, self.water, {0: VACUUM, 1: WATER})
        ends = np.array([[[0, -SOURCE_MM, 0]], [[0, PANEL_MM, 0]], [[1, 0, 0]], [[0, 0, 1]]])
        geometry = ScanGeometry(ends[0], ends[1], ends[2], ends[3], self.panel)
        beam = Beam.of_view(geometry, 0, self.energies, self.photons)
        return Simulation(body, beam, dose=False, detector=Detector(geometry))

    @cached_property
    def primary(self) -> Images:
        """Our primary signal, by rays 2 mm apart."""
        return self.simulation.primary(round(self.panel.pitch_u / 2))

    def run(self, photons: int, seed: int) -> tuple[Images, float]:
        """Return our images, keV a photon, (4, rows, columns), and processor seconds."""
        start = time.process_time()
        scatter = self.simulation.run(photons, 1, seed=seed).scatter()[0]
        return np.stack([self.primary, *scatter]), time.process_time() - start


@dataclass(frozen=True)
class McGpu:
    """MC-GPU for one scene, with its input files in a folder."""

    binary: Path
    water: Path
    folder: Path
    scene: Scene

    def write(self) -> None:
        """Write voxels and spectrum."""
        scene = self.scene
        numbers, edges = scene.grid.shape[::-1], scene.grid.voxel / 10
        voxels = [f"1 {VACUUM.density_g_cm3:g}\n", f"1 {WATER.density_g_cm3:g}\n"]
        head = f"[SECTION VOXELS HEADER]\n{_line(numbers)}{_line(edges)}[END OF VXH SECTION]\n"
        body = "".join(voxels[int(w)] for w in scene.water.ravel())
        (self.folder / "body.vox").write_text(head + body, encoding="ascii")
        # Each line fills a bin of 1 eV; the bins between are empty.
        lines = zip(1000 * scene.energies, scene.photons / scene.photons.max(), strict=True)
        bins = "".join(f"{e - 0.5:.1f} {n:.6e}\n{e + 0.5:.1f} 0\n" for e, n in lines)
        end = f"{1000 * scene.energies[-1] + 1:.1f} -1\n"
        (self.folder / "tube.spc").write_text(bins + end, encoding="ascii")

    def run(self, photons: int, seed: int) -> tuple[Images, float]:
        """Return its images, keV a photon, (4, rows, columns), and processor seconds."""
        (self.folder / "case.in").write_text(self._input(photons, seed), encoding="ascii")
        said = subprocess.run(
            [self.binary.resolve(), "case.in"],
            cwd=self.folder,
            check=True,
            capture_output=True,
            encoding="latin-1",
        ).stdout
        found = re.search(r"Simulation time \[s\]:\s*([\d.]+)", said)
        assert found is not None, said[-2000:]
        panel = self.scene.panel
        table = np.loadtxt(self.folder / "image.dat", comments="#")
        area_cm2 = panel.pitch_u * panel.pitch_v / 100
        images = table.T.reshape(4, panel.rows, panel.columns) * area_cm2 / 1000
        return images, float(found[1])

    def _input(self, photons: int, seed: int) -> str:
        panel, size = self.scene.panel, self.scene.grid.size_mm / 10
        source = size / 2 - [0, SOURCE_MM / 10, 0]
        sections = {
            "SIMULATION CONFIG v.2009-05-12": (photons, seed, 0, 128, 10_000),
            "SOURCE v.2011-07-12": ("tube.spc", _line(source), "0 1 0", "-1 -1"),
            "IMAGE DETECTOR v.2009-12-02": (
                "image.dat",
                f"{panel.columns} {panel.rows}",
                _line(np.array(panel.size_mm) / 10),
                (SOURCE_MM + PANEL_MM) / 10,
            ),
            "CT SCAN TRAJECTORY v.2011-10-25": (1, 0, "0 5000", SOURCE_MM / 10, 0),
            "DOSE DEPOSITION v.2012-12-12": ("NO", "NO", "none", "1 1", "1 1", "1 1"),
            "VOXELIZED GEOMETRY FILE v.2009-11-30": ("body.vox",),
            "MATERIAL FILE LIST v.2009-11-30": (self.water.resolve(),),
        }
        # Names must end at a blank: MC-GPU reads on otherwise.
        return "".join(
            f"#[SECTION {name}]\n" + "".join(f"{str(value).strip()} #\n" for value in values)
            for name, values in sections.items()
        )


def _line(numbers: object) -> str:
    return " ".join(f"{n:g}" for n in np.asarray(numbers).tolist()) + "\n"


def with_our_coefficients(water: Path, folder: Path) -> Path:
    """Write MC-GPU's file of water with our mean free paths, and return its path."""
    table = media_tables([WATER]).coefficients[0].astype(np.float64)
    lines = []
    for line in water.read_text(encoding="latin-1").splitlines():
        if not line.startswith("#") and len(numbers := line.split()) == 6 and "[" not in line:
            energy = float(numbers[0])
            if energy >= 5000:  # the table of mean free paths; later tables hold small numbers
                mu = [np.interp(energy / 1000, energies_kev(), column) for column in table.T]
                total, compton, rayleigh = (10 * mu[n] for n in (TOTAL, COMPTON, RAYLEIGH))
                parts = (rayleigh, compton, total - compton - rayleigh, total)
                paths = " ".join(f"{1 / part:.10E}" for part in parts)
                line = f" {energy:.10E} {paths} {numbers[5]}"
        lines.append(line + "\n")
    path = folder / "water.mcgpu"
    path.write_text("".join(lines), encoding="latin-1")
    return path


def tube(kv: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return energies and photons of a tube with 3 mm of aluminium, from 10 keV on."""
    spectrum = tube_spectrum(kv)
    energies = np.asarray(spectrum.energies_kev)
    mu = np.array([material("aluminium").mu_per_mm(energy) for energy in energies.tolist()])
    photons = np.asarray(spectrum.photons) * np.exp(-3 * mu)
    return energies[energies > 10], photons[energies > 10]


def cubes() -> Iterator[Scene]:
    """Yield a cube of water of 200 mm at 60 keV and 120 kVp."""
    grid = VolumeGrid((100, 100, 100), 2.0)
    water = np.ones(grid.shape, bool)
    for name, lines in (("60 keV", (np.array([60.0]), np.ones(1))), ("120 kVp", tube(120))):
        yield Scene(f"cube, {name}", grid, water, Panel(5, 5, 80.0, 80.0), *lines)


def cylinders(radii_mm: Sequence[int], tubes_kv: Sequence[int]) -> Iterator[Scene]:
    """Yield cylinders of water along z, longer than the field, in voxels of 2 x 2 x 10 mm."""
    for radius in radii_mm:
        across = radius + 2
        grid = VolumeGrid((30, across, across), [2.0, 2.0, 10.0])
        x, y, _ = grid.axes()
        disc = np.hypot(x, y[:, None]) < radius
        water = np.broadcast_to(disc, grid.shape)
        for kv in tubes_kv:
            panel = Panel(9, 9, 40.0, 40.0)
            yield Scene(f"{radius} mm, {kv} kVp", grid, water, panel, *tube(kv))


def repeated(runs: tuple[Run, Run], seeds: int) -> list[tuple[Images, float]]:
    """Run both codes in turns, with each seed.

    Returns:
        Images of all seeds, (seeds, 4, rows, columns), and processor seconds of one, for each code.
    """
    found = [[run(1 + seed) for run in runs] for seed in range(seeds)]
    images, seconds = (
        [[pair[n] for pair in code] for code in zip(*found, strict=True)] for n in range(2)
    )
    means = np.mean(seconds, axis=1).tolist()
    return list(zip(map(np.array, images), means, strict=True))


def _error(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard error of a mean over seeds, the first axis."""
    return values.std(axis=0, ddof=1) / np.sqrt(len(values))


def compare_radiograph(own: Images, theirs: Images) -> None:
    """Print differences by region, relative to the whole signal, and of the whole panel."""
    a, b = own.mean(axis=0), theirs.mean(axis=0)
    off = (a - b) / b.sum(axis=0)
    error = np.hypot(_error(own), _error(theirs)) / b.sum(axis=0)
    whole = own.sum(axis=(2, 3)), theirs.sum(axis=(2, 3))
    ratio = whole[0].mean(axis=0) / whole[1].mean(axis=0) - 1
    apart = np.hypot(*(_error(w) / w.mean(axis=0) for w in whole))
    for n, kind in enumerate(KINDS):
        print(
            f"  {kind}: regions off by {off[n].min():+.2%} to {off[n].max():+.2%} of the whole "
            f"signal there (standard errors at most {error[n].max():.2%}), "
            f"{(abs(off[n]) <= MOST).sum()} of {off[n].size} within {MOST:.0%}; "
            f"panel {ratio[n]:+.2%} (+- {apart[n]:.2%})"
        )


def compare_speed(both: Sequence[tuple[Images, float]]) -> None:
    """Print variance times processor time relative to MC-GPU's, each a mean over the regions.

    Args:
        both: images of both codes, and the processor seconds of one of them.
    """
    scores = {kind: [n] for n, kind in enumerate(KINDS)}
    del scores["primary"]  # ours has no variance
    for kind, used in (scores | {"all scatter": [1, 2, 3]}).items():
        found = []
        for images, seconds in both:
            score = images[:, used].sum(axis=1)
            relative = score.var(axis=0, ddof=1) / score.mean(axis=0) ** 2
            found.append(float(relative.mean()) * seconds)
        print(f"  {kind}: variance times time {found[0] / found[1]:.2f} x MC-GPU's", flush=True)


def compare_cylinder(own: Images, theirs: Images) -> None:
    """Print scatter to primary of the middle column."""
    columns = [images[..., images.shape[-1] // 2].sum(axis=-1) for images in (own, theirs)]
    ratios = [column[:, 1:].sum(axis=1) / column[:, 0] for column in columns]
    means = [float(ratio.mean()) for ratio in ratios]
    errors = [float(_error(r)) / m for r, m in zip(ratios, means, strict=True)]
    primary = columns[0][:, 0].mean() / columns[1][:, 0].mean() - 1
    scatter = columns[0][:, 1:].sum(axis=1).mean() / columns[1][:, 1:].sum(axis=1).mean() - 1
    off = means[0] / means[1] - 1
    print(
        f"  scatter to primary {means[0]:.4g} against {means[1]:.4g}: {off:+.2%} (+- "
        f"{np.hypot(errors[0], errors[1]):.2%}){'' if abs(off) <= MOST else '  OUTSIDE'}; primary "
        f"{primary:+.2%}, scatter {scatter:+.2%}",
        flush=True,
    )


def main() -> None:
    """Run both codes, and compare."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("what", choices=("radiograph", "speed", "cylinders"))
    parser.add_argument("--binary", type=Path, required=True, help="MC-GPU for one thread")
    parser.add_argument("--water", type=Path, required=True, help="its file of water")
    parser.add_argument("--photons", type=float, default=1e7, help="of MC-GPU, for each seed")
    parser.add_argument("--own-photons", type=float, default=2e6, help="of ours, for each seed")
    parser.add_argument("--coefficients", choices=("theirs", "own"), default="theirs")
    parser.add_argument("--radii", type=int, nargs="+", default=RADII_MM, help="of cylinders, mm")
    parser.add_argument("--tubes", type=int, nargs="+", default=TUBES_KV, help="voltages, kV")
    given = parser.parse_args()
    limit_threads(1)
    counts, seeds = [round(given.own_photons), round(given.photons)], SEEDS
    if given.what == "speed":
        counts, seeds = [n // 10 for n in counts], SEEDS_OF_SPEED
    with tempfile.TemporaryDirectory() as name:
        folder, water = Path(name), given.water
        if given.coefficients == "own":
            water = with_our_coefficients(water, folder)
        behind = given.what == "cylinders"
        for scene in cylinders(given.radii, given.tubes) if behind else cubes():
            print(scene.name, flush=True)
            other = McGpu(given.binary, water, folder, scene)
            other.write()
            scene.run(10, 0)
            runs = (partial(scene.run, counts[0]), partial(other.run, counts[1]))
            both = repeated(runs, seeds)
            if behind:
                compare_cylinder(both[0][0], both[1][0])
            elif given.what == "radiograph":
                compare_radiograph(both[0][0], both[1][0])
            else:
                times = [1e6 * s / n for (_, s), n in zip(both, counts, strict=True)]
                print(f"  microseconds a photon: {times[0]:.2f}, MC-GPU {times[1]:.2f}")
                compare_speed(both)


if __name__ == "__main__":
    main()
