"""Monte Carlo transport against the four codes of AAPM Task Group report 195, entry by entry.

    python benchmarks/bench_tg195.py --data FOLDER --photons 20 --out tg195.csv
    python benchmarks/bench_tg195.py --data FOLDER --cases 2 4.1

The folder holds ``results.csv`` with the energies of EGSnrc, Geant4, MCNP and Penelope (Sechopoulos
et al., Med. Phys. 42 (2015) 5679), and ``case5world.bin`` with the voxels of case 5, or the archive
of it. Geometry: the report. Materials and spectra: its tables.

Bodies stand in air that fills the room. Faces of boxes lie on faces of voxels; voxels on a round
surface hold a share of the density. Case 4.2 rotates the scored cylinder instead of the source.
"""

from __future__ import annotations

import argparse
import csv
import tarfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.threads import limit_threads
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.specimen.materials import Material
from twinct.transport import Beam, Detector, Regions, Scores, Simulation, VoxelBody

CODES = ("EGSnrc", "Geant4", "MCNP", "Penelope")
BATCHES = 40
SEED = 195
MOST_DEVIATION = 0.02
MOST_DEVIATION_HVL = 0.005
MOST_ERROR = 0.005
SPECTRA = Path(__file__).parent / "tg195_spectra.csv"

_SOFT = {"H": 10.5, "C": 25.6, "N": 2.7, "O": 60.2, "Na": 0.1, "P": 0.2, "S": 0.3, "Cl": 0.2}
_GUT = {"H": 10.6, "C": 11.5, "N": 2.2, "O": 75.1, "Na": 0.1, "P": 0.1, "S": 0.1, "Cl": 0.2}
_FAT = {"H": 11.2, "C": 61.9, "N": 1.7, "O": 25.1} | dict.fromkeys(("P", "S", "K", "Ca"), 0.025)
_GLAND = {"H": 10.2, "C": 18.4, "N": 3.2, "O": 67.7} | dict.fromkeys(("P", "S", "K", "Ca"), 0.125)


def _material(name: str, density: float, percent: dict[str, float]) -> Material:
    total = sum(percent.values())
    return Material(name, density, {s: share / total for s, share in percent.items()})


AIR = _material("air", 0.001205, {"C": 0.0124, "N": 75.5268, "O": 23.1781, "Ar": 1.2827})
SOFT = _material("soft tissue", 1.03, _SOFT | {"K": 0.2})
PMMA = _material("PMMA", 1.19, {"H": 8.0541, "C": 59.9846, "O": 31.9613})
WATER = _material("water", 1.0, {"H": 11.1898, "O": 88.8102})
SKIN = _material(
    "skin",
    1.09,
    {"H": 9.8, "C": 17.8, "N": 5.0, "O": 66.7} | dict.fromkeys(("P", "S", "K", "Ca"), 0.175),
)
BREAST = _material(
    "breast",
    0.8 * 0.93 + 0.2 * 1.04,
    {s: 0.8 * _FAT[s] + 0.2 * _GLAND[s] for s in _FAT},
)
ALUMINIUM = Material("aluminium", 2.699, {"Al": 1.0})


def _organ(name: str, density: float, *percent: float, **more: float) -> Material:
    """Return a tissue from its shares of H, C, N, O, Na, P, S, Cl and K, in percent."""
    symbols = ("H", "C", "N", "O", "Na", "P", "S", "Cl", "K")
    shares = {s: p for s, p in zip(symbols, percent, strict=False) if p}
    return _material(name, density, shares | more)


_GUTS = (*_GUT.values(), 0.1)
_SOFTS = (*_SOFT.values(), 0.2)
ORGANS = (
    AIR,
    _organ("cushion", 0.075, 7.8, 64.7, 8.4, 19.1),
    _material("carbon", 1.2, {"C": 100.0}),
    SOFT,
    _organ("Heart", 1.05, 10.4, 13.9, 2.9, 71.8, 0.1, 0.2, 0.2, 0.2, 0.3),
    _organ("Lung", 0.26, 10.3, 10.5, 3.1, 74.9, 0.2, 0.2, 0.3, 0.3, 0.2),
    _organ("Liver", 1.06, 10.2, 13.9, 3.0, 71.6, 0.2, 0.3, 0.3, 0.2, 0.3),
    _organ("Gallbladder", 1.03, *_SOFTS),
    _organ("Spleen", 1.06, 10.3, 11.3, 3.2, 74.1, 0.1, 0.3, 0.2, 0.2, 0.3),
    _organ("Stomach", 1.03, *_GUTS),
    _organ("Large Intestine", 1.03, *_GUTS),
    _organ("Pancreas", 1.04, 10.6, 16.9, 2.2, 69.4, 0.2, 0.2, 0.1, 0.2, 0.2),
    _organ("Adrenal", 1.03, *_SOFTS),
    _organ("Thyroid", 1.05, 10.4, 11.9, 2.4, 74.5, 0.2, 0.1, 0.1, 0.2, 0.1, I=0.1),
    _organ("Thymus", 1.03, *_SOFTS),
    _organ("Small Intestine", 1.03, *_GUTS),
    _organ("Esophagus", 1.03, *_GUTS),
    _organ("Skin", 1.09, 10.0, 20.4, 4.2, 64.5, 0.2, 0.1, 0.2, 0.3, 0.1),
    _organ("Breast", 0.93, 11.2, 61.9, 1.7, 25.1, 0, 0.025, 0.025, 0, 0.025, Ca=0.025),
    _organ("Cortical Bone", 1.92, 3.4, 15.5, 4.2, 43.5, 0.1, 10.3, 0.3, Mg=0.2, Ca=22.5),
)
"""Materials of case 5 by label."""

ORGAN_NAMES = {3: "Soft tissue"} | {n: ORGANS[n].name for n in range(4, len(ORGANS))}


@dataclass(frozen=True)
class Reference:
    """Results of the codes for one entry, eV per photon."""

    values: tuple[float, ...]
    errors: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median of the codes."""
        return float(np.median(self.values))

    @property
    def error(self) -> float:
        """Median of the codes' relative standard errors."""
        return float(np.median(self.errors))


Key = tuple[str, str, str, str]
Named = dict[str, tuple[float, float]]
Entries = dict[Key, tuple[float, float]]
Share = NDArray[np.float64]


def references(folder: Path) -> dict[Key, Reference]:
    """Return the results of the codes by case, volume, spectrum and mode."""
    found = {}
    with (folder / "results.csv").open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            pairs = [(row[f"{c}_Result"], row[f"{c}_Uncertainty"]) for c in CODES]
            there = [(float(v), float(e or 0)) for v, e in pairs if v and float(v) > 0]
            key = (row["Case"], row["Volume"], row["Specter"], row["Mode"])
            values, errors = zip(*there, strict=True)
            found[key] = Reference(values, errors)
    return found


def _spectra() -> dict[str, np.ndarray]:
    lines = SPECTRA.read_text(encoding="utf-8").splitlines()
    names = lines[2].split(",")
    columns = np.loadtxt(lines[3:], delimiter=",").T
    return dict(zip(names, columns, strict=True))


def lines_of(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return energies and photons of ``56.4 keV`` or ``120 kVp``."""
    value, unit = name.split()
    if unit == "keV":
        return np.array([float(value)]), np.array([1.0])
    spectra = _spectra()
    used = spectra[name] > 0
    return spectra["energy_kev"][used], spectra[name][used]


def case_1(_: int, __: Path) -> Iterator[Entries]:
    """Yield air kerma behind aluminium, and half-value layers: primary photons alone."""
    thickness_mm = {
        "30 keV": (2.273, 4.546),
        "100 keV": (15.11, 30.22),
        "30 kVp": (0.3431, 0.7663),
        "100 kVp": (3.950, 9.840),
    }
    table = _spectra()
    panel = Panel(1, 1, 1.0, 1.0)
    ends = np.zeros((1, 3)), np.array([[0, 0, -1000.0]])
    geometry = ScanGeometry(*ends, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]), panel)
    for name, layers in thickness_mm.items():
        energies, photons = lines_of(name)
        mode = "monoenergetic" if name.endswith("keV") else "polyenergetic"
        # The report's table has bins of 0.5 keV, and those of 30 and 100 keV end there.
        bins = np.where(energies % 0.5 == 0, energies - 0.25, energies)

        def response(e, energies=energies, bins=bins):
            absorbed = np.interp(bins, table["energy_kev"], table["air"])
            return np.interp(e, energies, bins * absorbed)

        kerma = []
        for layer in (0.0, *layers):
            grid = VolumeGrid((1, 1, 1), [20.0, 20.0, layer or 1.0])
            labels = np.full(grid.shape, int(layer > 0))
            body = VoxelBody.of_labels(grid, labels, {0: AIR, 1: ALUMINIUM}, AIR)
            # The layer, about the origin, begins 100 mm below the source.
            shift = np.array([0, 0, 100 + layer / 2])
            moved = ScanGeometry(
                geometry.source + shift, geometry.detector + shift, geometry.u, geometry.v, panel
            )
            beam = Beam.of_view(moved, 0, energies, photons)
            detector = Detector(moved, 0, response)
            image = Simulation(body, beam, dose=False, detector=detector).primary(5)
            # Per photon through a circle of 5 mm radius: the fluence is that of 1 / pi 0.25 cm^2.
            kerma.append(float(image[0, 0]) / 100 / (np.pi * 0.25))
        filters = zip(("NoneFilter", "HVLFilter", "QVLFilter"), kerma, strict=True)
        entries: Entries = {("Case 1", v, name, mode): (k, 0.0) for v, k in filters}
        ratios = zip(("HVL", "QVL"), (kerma[1] / kerma[0], kerma[2] / kerma[0]), strict=True)
        yield entries | {("Case 1 HVL", v, name, mode): (r, 0.0) for v, r in ratios}


def case_2(photons: int, _: Path) -> Iterator[Entries]:
    """Yield the energies of a slab of soft tissue, from above and at 15 degrees."""
    grid = VolumeGrid((40, 78, 78), 5.0)
    body = VoxelBody.of_labels(grid, np.ones(grid.shape, int), {1: SOFT}, AIR)
    centres = {1: (0, -150, 0), 2: (-150, 0, 0), 3: (0, 0, 0), 4: (150, 0, 0), 5: (0, 150, 0)}
    centres |= {6: (0, 0, -60), 7: (0, 0, -30), 8: (0, 0, 30), 9: (0, 0, 60)}
    shares = {f"VOI {n}": _box_share(grid, c, (30, 30, 30)) for n, c in centres.items()}
    regions = Regions.of_shares({"Total body": np.ones(grid.shape)} | shares)
    for name in ("56.4 keV", "120 kVp"):
        for mode, angle in (("radiography", 0.0), ("tomosynthesis", 15.0)):
            # The source is 1650 mm above the slab's centre, the field 150 mm below it.
            source = (0.0, -1800 * np.tan(np.radians(angle)), -1650.0)
            beam = Beam(source, (0, 0, 150), (195, 0, 0), (0, 195, 0), *lines_of(name))
            energies = _run(body, beam, regions, photons)
            yield {("Case 2", v, name, mode): pair for v, pair in energies.items()}


def case_3(photons: int, _: Path) -> Iterator[Entries]:
    """Yield the energies of a breast between two plates, before a body of water."""
    grid = VolumeGrid((300, 300, 310), 1.0)
    # The chest wall, x = 0 in the report, is 15 mm from the grid's centre.
    wall = np.array([15, 0, 0])
    x, y, z = grid.axes()
    x, y, z = x - wall[0], y[:, None], z[:, None, None]
    disc = _disc_share(grid, wall[0], 0, 100)
    deep = (np.hypot(x, y) < 98.0) & (abs(z) < 23.0)
    breast = (x > 0) & (abs(z) < 25.0) & (disc > 0)
    plates = (x > 0) & (x < 140) & (abs(y) < 130) & (abs(z) > 25) & (abs(z) < 27)
    kinds = [AIR, WATER, PMMA, SKIN, BREAST]
    media = np.zeros(grid.shape, np.uint8)
    for n, where in enumerate((x < 0, plates, breast & ~deep, breast & deep), 1):
        media[np.broadcast_to(where, grid.shape)] = n
    density = np.array([kind.density_g_cm3 for kind in kinds], np.float32)[media]
    density *= np.where(media >= 3, disc, 1).astype(np.float32)
    body = VoxelBody.of_densities(grid, media, density, kinds, AIR)
    centres = {1: (50, 50, 0), 2: (20, 0, 0), 3: (50, 0, 0), 4: (80, 0, 0), 5: (50, -50, 0)}
    centres |= {6: (50, 0, -15), 7: (50, 0, 15)}
    boxes = {n: _box_share(grid, wall + c, (20, 20, 10)) for n, c in centres.items()}
    regions = Regions.of_shares(
        {"Total body": media == 4} | {f"VOI {n}": b for n, b in boxes.items()}
    )
    for name in ("16.8 keV", "30 kVp"):
        for mode, angle in (("radiography", 0.0), ("tomosynthesis", 15.0)):
            turn = np.radians(angle)
            source = wall + [0, -620 * np.sin(turn), 620 * np.cos(turn)]
            beam = Beam(source, wall + [70, 0, -40], (70, 0, 0), (0, 130, 0), *lines_of(name))
            energies = _run(body, beam, regions, photons)
            yield {("Case 3", v, name, mode): pair for v, pair in energies.items()}


def _cylinder() -> tuple[VolumeGrid, VoxelBody]:
    """Return a cylinder of PMMA of 160 mm radius, 1 m long: scatter from farther is below 1e-4."""
    grid = VolumeGrid((101, 160, 160), [2.0, 2.0, 10.0])
    share = np.broadcast_to(_disc_share(grid, 0, 0, 160), grid.shape)
    density = np.where(share > 0, share * PMMA.density_g_cm3, AIR.density_g_cm3)
    return grid, VoxelBody.of_densities(grid, share > 0, density, [AIR, PMMA], AIR)


def _cylinder_runs(
    body: VoxelBody, regions: Regions, photons: int
) -> Iterator[tuple[str, str, Named]]:
    """Yield spectrum, collimation and energies for the four beams of case 4."""
    for name in ("56.4 keV", "120 kVp"):
        for width in (10, 80):
            beam = Beam((-600, 0, 0), (0, 0, 0), (0, 160, 0), (0, 0, width / 2), *lines_of(name))
            yield name, f"{width}mm collimation", _run(body, beam, regions, photons)


def case_4_1(photons: int, _: Path) -> Iterator[Entries]:
    """Yield the energies of slices of a long cylinder; both sides of the beam are averaged."""
    grid, body = _cylinder()
    shares = {}
    for n in range(4):
        share = np.zeros(grid.shape)
        for sign in (1, -1):
            share[50 + sign * n] += 0.5 * (_disc_share(grid, 0, 0, 160) > 0)
        shares[f"VOI {n + 1}"] = share
    for name, mode, energies in _cylinder_runs(body, Regions.of_shares(shares), photons):
        yield {("Case 4.1", volume, name, mode): pair for volume, pair in energies.items()}


def case_4_2(photons: int, _: Path) -> Iterator[Entries]:
    """Yield the energies of rods of 5 mm radius and 100 mm length, by angle of the source.

    Turning the source by an angle is like turning the outer rod back by it, so that one run has all
    angles. The mirrored angle has the same energy, and their rods share a region.
    """
    grid, body = _cylinder()
    layers = np.zeros((grid.shape[0], 1, 1))
    layers[45:56] = 1.0
    layers[[45, 55]] = 0.5
    rods = {"Center": layers * _disc_share(grid, 0, 0, 5)}
    for angle in range(0, 190, 10):
        turn = np.radians(angle)
        pair = [_disc_share(grid, -150 * np.cos(turn), s * 150 * np.sin(turn), 5) for s in (1, -1)]
        rods[str(angle)] = layers * (pair[0] + pair[1]) / 2
    regions = Regions.of_shares(rods)
    for name, mode, energies in _cylinder_runs(body, regions, photons):
        entries: Entries = {}
        for angle in range(0, 360, 10):
            key = ("Case 4.2", str(angle), name)
            entries[(*key, f"Center {mode}")] = energies["Center"]
            entries[(*key, f"Pherifery {mode}")] = energies[str(min(angle, 360 - angle))]
        key = ("Case 4.2", "Continuous", name)
        entries[(*key, f"Center {mode}")] = energies["Center"]
        outer = [energies[str(min(a, 360 - a))] for a in range(0, 360, 10)]
        mean = float(np.mean([e for e, _ in outer]))
        entries[(*key, f"Pherifery {mode}")] = (
            mean,
            float(np.hypot.reduce([d for _, d in outer]) / 36),
        )
        yield entries


def phantom(folder: Path) -> tuple[NDArray[np.uint8], VoxelBody]:
    """Return the labels of case 5, and its body."""
    grid = VolumeGrid((260, 320, 500), 1.0)
    labels = np.frombuffer(_voxels(folder), np.uint8).reshape(grid.shape)
    return labels, VoxelBody.of_labels(grid, labels, dict(enumerate(ORGANS)), AIR)


def beam_5(name: str, angle: float) -> Beam:
    """Return a beam of case 5 from an angle in degrees."""
    s, c = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    return Beam(
        (-600 * s, -600 * c, 0), (0, 0, 0), (-250 * c, 250 * s, 0), (0, 0, 5), *lines_of(name)
    )


def case_5(photons: int, folder: Path) -> Iterator[Entries]:
    """Yield the energies of 17 organs, from eight angles and on average."""
    labels, body = phantom(folder)
    for name in ("56.4 keV", "120 kVp"):
        runs = []
        for angle in range(0, 360, 45):
            simulation = Simulation(body, beam_5(name, angle), dose=False, unscattered=False)
            scores = _simulated(simulation, photons)
            means, errors = (1000 * part for part in scores.label_energy())
            free = simulation.primary_energy().ravel()
            means += 1000 * np.bincount(labels.ravel(), free, len(means))[: len(means)]
            runs.append((means, errors))
            yield {
                ("Case 5", organ, name, str(angle)): (float(means[n]), float(errors[n]))
                for n, organ in ORGAN_NAMES.items()
            }
        mean = np.mean([m for m, _ in runs], axis=0)
        error = np.hypot.reduce([e for _, e in runs]) / len(runs)
        yield {
            ("Case 5", organ, name, "Continuous"): (float(mean[n]), float(error[n]))
            for n, organ in ORGAN_NAMES.items()
        }


def _voxels(folder: Path) -> bytes:
    plain, packed = folder / "case5world.bin", folder / "case5world.tar.gz"
    if plain.exists():
        return plain.read_bytes()
    with tarfile.open(packed) as archive:
        member = archive.extractfile("case5world.bin")
        assert member is not None
        return member.read()


def _box_share(grid: VolumeGrid, centre: ArrayLike, size: tuple[float, float, float]) -> Share:
    """Return the voxels of a box whose faces lie on theirs; sizes along (x, y, z), mm."""
    axes = zip(grid.axes(), np.asarray(centre), size, strict=True)
    x, y, z = (abs(axis - c) < s / 2 for axis, c, s in axes)
    return (x & y[:, None] & z[:, None, None]).astype(np.float64)


def _disc_share(grid: VolumeGrid, x: float, y: float, radius: float) -> Share:
    """Return the share of each voxel's cross section, (y, x), in a disc; 20 x 20 points a voxel."""
    fine = (np.arange(20) - 9.5) / 20
    share = np.zeros(grid.shape[1:])
    across, up = grid.axes()[0] - x, grid.axes()[1][:, None] - y
    for i in fine * grid.voxel[0]:
        for j in fine * grid.voxel[1]:
            share += np.hypot(across + i, up + j) < radius
    return share / len(fine) ** 2


def _simulated(simulation: Simulation, photons: int) -> Scores:
    start = time.process_time()
    scores = simulation.run(max(photons // BATCHES, 1), BATCHES, seed=SEED)
    spent = time.process_time() - start
    number = scores.photons * scores.batches
    print(
        f"  {number:.3g} photons, {number / spent / 1e6:.3f} M/s of processor time, "
        f"{scores.collisions:.2f} collisions each, imbalance {scores.imbalance:.1e}",
        flush=True,
    )
    return scores


def _run(body: VoxelBody, beam: Beam, regions: Regions, photons: int) -> Named:
    """Return the energies of regions and their standard errors, eV per photon.

    Rays to their voxels give the energy of unscattered photons, without chance.
    """
    simulation = Simulation(body, beam, regions=regions, unscattered=False)
    scores = _simulated(simulation, photons)
    cells = np.unique(regions.shares.indices)
    free = regions.shares[:, cells] @ simulation.primary_energy(cells)
    pairs = zip(scores.region_energy().items(), free.tolist(), strict=True)
    return {name: ((mean + own) * 1000, error * 1000) for (name, (mean, error)), own in pairs}


CASES: dict[str, Callable[[int, Path], Iterator[Entries]]] = {
    "1": case_1,
    "2": case_2,
    "3": case_3,
    "4.1": case_4_1,
    "4.2": case_4_2,
    "5": case_5,
}


def _judged(
    key: Key, own: tuple[float, float], reference: Reference
) -> dict[str, str | float | bool]:
    mean, error = own
    deviation = mean / reference.median - 1
    combined = float(np.hypot(error / mean if mean else 0, reference.error))
    most = MOST_DEVIATION_HVL if key[0].startswith("Case 1") else MOST_DEVIATION
    return {
        **dict(zip(("case", "volume", "spectrum", "mode"), key, strict=True)),
        "own": mean,
        "error_percent": 100 * error / mean if mean else 0.0,
        "median": reference.median,
        "deviation_percent": 100 * deviation,
        "within": abs(deviation) <= max(most, 2 * combined),
    }


def _summary(case: str, rows: list[dict[str, str | float | bool]]) -> str:
    deviations = np.array([float(row["deviation_percent"]) for row in rows])
    errors = np.array([float(row["error_percent"]) for row in rows])
    return (
        f"case {case}: {sum(bool(row['within']) for row in rows)} of {len(rows)} entries within, "
        f"signed mean deviation {deviations.mean():+.2f} %, largest {abs(deviations).max():.2f} %, "
        f"own standard error at most {errors.max():.2f} %, "
        f"{(errors <= 100 * MOST_ERROR).sum()} entries at most {100 * MOST_ERROR:g} %"
    )


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with results.csv")
    parser.add_argument("--photons", type=float, default=4.0, help="millions for each beam")
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--threads", type=int)
    parser.add_argument("--out", type=Path, help="a table of all entries")
    options = parser.parse_args()
    limit_threads(options.threads)
    known = references(options.data)
    table = []
    for case in options.cases:
        rows = []
        for entries in CASES[case](round(options.photons * 1e6), options.data):
            for key, own in entries.items():
                row = _judged(key, own, known[key])
                rows.append(row)
                mark = "" if row["within"] else "  OUTSIDE"
                print(
                    f"{', '.join(key)}: {own[0]:.5g} +- {row['error_percent']:.2f} %, median "
                    f"{row['median']:.5g}, {row['deviation_percent']:+.2f} %{mark}"
                )
        table += rows
        print(_summary(case, rows), flush=True)
    if options.out is not None and table:
        with options.out.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(table[0]))
            writer.writeheader()
            writer.writerows(table)


if __name__ == "__main__":
    main()
