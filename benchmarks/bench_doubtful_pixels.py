"""How imports repair doubtful pixels: hits, starved pixels and clean scans of fine structures.

python benchmarks/bench_doubtful_pixels.py clean      repair on and off, on scans without hits
python benchmarks/bench_doubtful_pixels.py hits       bright and dark hits of three densities
python benchmarks/bench_doubtful_pixels.py starved    few photons, and other values of CLEAR
python benchmarks/bench_doubtful_pixels.py constants  other values of OUT, ALONE, MOST_TOGETHER
python benchmarks/bench_doubtful_pixels.py air        flats of another exposure, and air: auto
python benchmarks/bench_doubtful_pixels.py rings      gains that flats miss, and the key rings
python benchmarks/bench_doubtful_pixels.py falls      flats without the beam's fall-off

Objects are drawn from ellipsoids by the seed: wires, foam, screws, balls and large parts. Their
transmissions are exact, but for 3 x 3 samples a pixel. Errors are RMS, relative to the object.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import twinct
from twinct.measured import import_measured, pixels
from twinct.measured.beam import FreeBeam
from twinct.measured.circle import Circle
from twinct.measured.corrections import corrections
from twinct.measured.description import read_description
from twinct.measured.doubts import Doubts
from twinct.measured.importing import ImportedScan
from twinct.measured.looks import Looks
from twinct.measured.orientation import placed
from twinct.measured.stack import open_stack
from twinct.measured.views import ImageFacts
from twinct.runs import load_scan
from twinct.scan import Scan
from twinct.xray.beam import fall_off

VIEWS, PIXELS, SAMPLES = 90, 80, 3
GEOMETRY = {
    "kind": "circle",
    "sod_mm": 100.0,
    "sdd_mm": 200.0,
    "pitch_mm": 0.8,
    "angles": {"step": 360 / VIEWS},
    "rotates": "object",
    "direction": "clockwise",
}
VOXELS, VOXEL_MM = (56, 56, 48), 0.5
FREE = 30000.0
Floats = NDArray[np.float64]


class Object:
    """Ellipsoids: matrices that make them unit balls, centres, and attenuation in 1/mm."""

    def __init__(self) -> None:
        self.parts: list[tuple[Floats, Floats, float]] = []

    def add(self, centre: Any, axes: Any, mu: float, turn: Rotation | None = None) -> None:
        matrix = np.diag(1 / np.asarray(axes, float))
        matrix = matrix if turn is None else matrix @ turn.as_matrix().T
        self.parts.append((matrix, np.asarray(centre, float), mu))

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats]:
        matrix, centre, mu = zip(*self.parts, strict=True)
        return np.array(matrix), np.array(centre), np.array(mu)


def inside(rng: np.random.Generator, radius: float, height: float) -> Floats:
    """A point in a cylinder about z."""
    angle, away = rng.uniform(0, 2 * np.pi), radius * np.sqrt(rng.random())
    return np.array([away * np.cos(angle), away * np.sin(angle), rng.uniform(-height, height)])


def wires(rng: np.random.Generator) -> Object:
    """A mesh of straight wires, 0.5 to 1.2 pixels thick, and loose ones."""
    made, turn = Object(), Rotation.random(random_state=rng)
    for at in np.arange(-8, 9, 2.0):
        made.add(turn.apply([at, 0, 2]), (0.15, 9, 0.15), 1.0, turn)
        made.add(turn.apply([0, at, 2]), (9, 0.15, 0.15), 1.0, turn)
    for _ in range(8):
        thick = rng.uniform(0.1, 0.25)
        loose = Rotation.random(random_state=rng)
        made.add(inside(rng, 5, 4), (thick, thick, rng.uniform(2, 6)), 1.0, loose)
    return made


def foam(rng: np.random.Generator) -> Object:
    made = Object()
    made.add((0, 0, 0), (11, 11, 10), 0.05)
    for _ in range(250):
        made.add(inside(rng, 6.5, 5.5), (rng.uniform(0.3, 1.0),) * 3, -0.05)
    return made


def screws(rng: np.random.Generator) -> Object:
    """Cores with a thread of thin discs, whose edges are sharp."""
    made = Object()
    for _ in range(3):
        turn, centre = Rotation.random(random_state=rng), inside(rng, 5, 4)
        made.add(centre, (1.0, 1.0, 6.0), 0.25, turn)
        for along in np.arange(-5, 5, 0.8):
            made.add(centre + turn.apply([0, 0, along]), (1.7, 1.7, 0.2), 0.25, turn)
        made.add(centre + turn.apply([0, 0, 5.5]), (2.6, 2.6, 0.7), 0.25, turn)
    return made


def balls(rng: np.random.Generator) -> Object:
    """Balls 1 to 5 pixels across, as bright as metal, in a fainter part."""
    made = Object()
    made.add((0, 0, 0), (10, 9, 8), 0.03)
    for _ in range(30):
        made.add(inside(rng, 7, 6), (rng.uniform(0.2, 1.0),) * 3, 1.0)
    return made


def parts(rng: np.random.Generator) -> Object:
    made = Object()
    made.add(rng.uniform(-1, 1, 3), rng.uniform(9, 12, 3), 0.02)
    for _ in range(6):
        turn = Rotation.random(random_state=rng)
        made.add(inside(rng, 6, 6), rng.uniform(1, 3, 3), rng.uniform(-0.02, 0.05), turn)
    return made


def spring(rng: np.random.Generator) -> Object:
    """A coil of wire 0.5 to 1.5 pixels thick, drawn by balls that overlap, and a pin in it."""
    made, turn = Object(), Rotation.random(random_state=rng)
    thick, radius, pitch = rng.uniform(0.1, 0.3), rng.uniform(2, 6), rng.uniform(0.8, 2.5)
    for angle in np.arange(-10, 10, 1.5 * thick / radius):
        at = [radius * np.cos(angle), radius * np.sin(angle), pitch * angle / (2 * np.pi)]
        made.add(turn.apply(at), (thick,) * 3, 0.5)
    made.add((0, 0, 0), (0.2, 0.2, 6), 1.0, turn)
    return made


def powder(rng: np.random.Generator) -> Object:
    """Grains of 0.5 to 2 pixels, some of metal, loosely spread."""
    made = Object()
    for _ in range(150):
        axes = rng.uniform(0.1, 0.4, 3)
        mu = 2.0 if rng.random() < 0.1 else 0.3
        made.add(inside(rng, 9, 7), axes, mu, Rotation.random(random_state=rng))
    return made


def shells(rng: np.random.Generator) -> Object:
    """Hollow balls with walls a quarter to one pixel thick."""
    made = Object()
    for _ in range(40):
        radius, wall = rng.uniform(0.8, 2.5), rng.uniform(0.1, 0.4)
        centre = inside(rng, 8, 7)
        made.add(centre, (radius,) * 3, 0.5)
        made.add(centre, (radius - wall,) * 3, -0.5)
    return made


HELD_OUT: dict[str, Callable[[np.random.Generator], Object]] = {
    "spring": spring,
    "powder": powder,
    "shells": shells,
}
"""Objects on which no constant was chosen."""

OBJECTS: dict[str, Callable[[np.random.Generator], Object]] = {
    "wires": wires,
    "foam": foam,
    "screws": screws,
    "balls": balls,
    "parts": parts,
}


@numba.njit(parallel=True, cache=False)
def _project(matrix, centre, mu, source, first, step_u, step_v, samples, out):
    for row in numba.prange(out.shape[0]):
        for column in range(out.shape[1]):
            total = 0.0
            for i in range(samples):
                for j in range(samples):
                    down = row + (i + 0.5) / samples - 0.5
                    right = column + (j + 0.5) / samples - 0.5
                    ray = first + right * step_u + down * step_v - source
                    length, p = np.sqrt((ray * ray).sum()), 0.0
                    for k in range(len(mu)):
                        a, b, c = 0.0, 0.0, -1.0
                        for m in range(3):
                            o, d = 0.0, 0.0
                            for n in range(3):
                                o += matrix[k, m, n] * (source[n] - centre[k, n])
                                d += matrix[k, m, n] * ray[n]
                            a += d * d
                            b += d * o
                            c += o * o
                        under = b * b - a * c
                        if under > 0:
                            p += mu[k] * 2 * np.sqrt(under) / a * length
                    total += np.exp(-p)
            out[row, column] = total / samples**2


def transmissions(made: Object) -> Floats:
    """Return exact images as they are stored: rows down, columns right."""
    circle = Circle.model_validate(GEOMETRY).views(ImageFacts(VIEWS, PIXELS, PIXELS))
    geometry = circle.geometry
    images = np.empty((VIEWS, PIXELS, PIXELS))
    for view in range(VIEWS):
        centres = geometry.pixel_centres(view)
        down, right = centres[1, 0] - centres[0, 0], centres[0, 1] - centres[0, 0]
        _project(
            *made.arrays, geometry.source[view], centres[0, 0], right, down, SAMPLES, images[view]
        )
    images = images[:, ::-1] if circle.flip_rows else images
    return images[:, :, ::-1] if circle.flip_columns else images


def truth(made: Object) -> Floats:
    """Return the mean attenuation of each voxel, (z, y, x), from 3 x 3 x 3 points."""
    x, y, z = ((np.arange(n * 3) - (n * 3 - 1) / 2) * VOXEL_MM / 3 for n in VOXELS)
    points = np.stack(np.meshgrid(z, y, x, indexing="ij"), -1)[..., ::-1]
    total = np.zeros(points.shape[:3])
    for matrix, centre, mu in made.parts:
        total += mu * ((((points - centre) @ matrix.T) ** 2).sum(-1) <= 1)
    nx, ny, nz = VOXELS
    return total.reshape(nz, 3, ny, 3, nx, 3).mean((1, 3, 5))


def imported(images: NDArray[Any], folder: Path, **keys: Any) -> tuple[Scan, ImportedScan]:
    """Import images, and return the stored scan and what was told."""
    np.save(folder / "images.npy", images)
    grid = {"voxels": list(VOXELS), "voxel_mm": VOXEL_MM}
    section = {"path": str(folder / "images.npy"), **keys}
    out = Path(tempfile.mkdtemp(dir=folder))
    told = import_measured({"images": section, "geometry": GEOMETRY, "grid": grid}, out / "scan")
    return load_scan(out / "scan"), told


def error(scan: Scan, known: Floats, algorithm: str = "fdk") -> float:
    volume = twinct.reconstruct(scan, algorithm=algorithm).array
    return float(np.sqrt(((volume - known) ** 2).mean() / (known**2).mean()))


def changed(one: Scan, other: Scan) -> float:
    return float((one.transmission != other.transmission).mean())


def counts_of(images: Floats, rng: np.random.Generator, photons: float | None) -> NDArray[Any]:
    lit = images if photons is None else rng.poisson(images * photons) / photons
    return np.round(FREE * lit).clip(0, 65535).astype(np.uint16)


INTENSITIES = {"values": "intensities", "white": FREE}


def told_of(values: list[float], digits: int = 3) -> str:
    return f"{np.mean(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def seen_in(counts: NDArray[Any], folder: Path) -> tuple[int, tuple[str, ...]]:
    """Return the number of single pixels that an import would repair, and its warnings."""
    np.save(folder / "images.npy", counts)
    section = {"path": str(folder / "images.npy"), **INTENSITIES}
    told = read_description({"images": section, "geometry": GEOMETRY})
    stack = open_stack(told.images, "images")
    placement = placed(told, stack)
    images = corrections(told.images, stack, FreeBeam(placement))
    looks = Looks(images)
    doubts = Doubts(told, images, placement.geometry, looks)
    for view in range(VIEWS):
        corrected = images.transmission(view)
        looks.add(view, corrected)
        doubts.add(view, corrected)
    return sum(looks.counts["bright"] + looks.counts["dark"]), doubts.sentences


def clean(seeds: range, folder: Path) -> None:
    print("| object | photons | pixels changed, % | error on / off | warnings |\n|" + "---|" * 5)
    for name, make in {**HELD_OUT, **OBJECTS}.items():
        rows: dict[float | None, tuple[list[float], list[float], list[str]]] = {
            photons: ([], [], []) for photons in (None, 20000.0, 1000.0)
        }
        for seed in seeds:
            made = make(np.random.default_rng([61, seed]))
            exact = transmissions(made)
            for photons, (share, ratio, doubts) in rows.items():
                counts = counts_of(exact, np.random.default_rng([62, seed]), photons)
                changes, sentences = seen_in(counts, folder)
                doubts += sentences
                share.append(100 * changes / counts.size)
                ratio.append(1.0)
                if changes:
                    on, _ = imported(counts, folder, **INTENSITIES)
                    off, _ = imported(counts, folder, **INTENSITIES, single_pixels=False)
                    ratio[-1] = error(on, truth(made)) / error(off, truth(made))
        for photons, (share, ratio, doubts) in rows.items():
            cells = f"{photons or 'all'} | {told_of(share, 4)} | {told_of(ratio, 4)}"
            print(f"| {name} | {cells} | {len(doubts)} |", *doubts, flush=True)


def hit(counts: NDArray[Any], rng: np.random.Generator, share: float, kind: str) -> NDArray[Any]:
    """Return counts with hits: the largest number, random additions, or pixels that failed."""
    where = rng.random(counts.shape) < share
    result = counts.copy()
    if kind == "full":
        result[where] = 65535
    elif kind == "random":
        more = counts[where] + rng.uniform(2000, 40000, where.sum())
        result[where] = np.minimum(more, 65535)
    else:
        result[where] = counts[where] * rng.uniform(0, 0.7, where.sum())
    return result


def hits(seeds: range, folder: Path) -> None:
    print("| object | kind | share, % | clean | left | repaired | missed, % |\n|" + "---|" * 7)
    for name in ("parts", "screws"):
        for kind in ("full", "random", "dark"):
            for share in (0.001, 0.005, 0.02):
                rows: list[list[float]] = [[], [], [], []]
                for seed in seeds:
                    rng = np.random.default_rng([61, seed])
                    made = OBJECTS[name](rng)
                    counts, known = counts_of(transmissions(made), rng, 20000.0), truth(made)
                    struck = hit(counts, rng, share, kind)
                    plain, _ = imported(counts, folder, **INTENSITIES)
                    left, _ = imported(struck, folder, **INTENSITIES, single_pixels=False)
                    on, _ = imported(struck, folder, **INTENSITIES)
                    rows[0].append(error(plain, known))
                    rows[1].append(error(left, known))
                    rows[2].append(error(on, known))
                    missed = (struck != counts).sum() - (on.transmission != left.transmission).sum()
                    rows[3].append(100 * missed / (struck != counts).sum())
                cells = (told_of(row) for row in rows)
                print(f"| {name} | {kind} | {100 * share:g} | {' | '.join(cells)} |", flush=True)


def starved(seeds: range, folder: Path) -> None:
    """Line integrals up to 9, of 3000 photons with a dark noise of 8."""
    ways = ("fdk", "sart", "fast")
    print(f"| CLEAR | {' | '.join(ways)} |\n|---|---|---|---|")
    for clear in (0.0, 2.0, 3.0, 4.0, 6.0):
        pixels.CLEAR = clear
        rows: dict[str, list[float]] = {way: [] for way in ways}
        for seed in seeds:
            rng = np.random.default_rng([61, seed])
            made = parts(rng)
            dense = Object()
            dense.parts = [(a, b, 14 * mu) for a, b, mu in made.parts]
            counts = rng.poisson(3000 * transmissions(dense))
            counts = counts + rng.normal(0, 8, counts.shape)
            scan, _ = imported((counts / 3000).astype(np.float32), folder, values="transmissions")
            for way in ways:
                rows[way].append(error(scan, truth(dense), way))
        print(f"| {clear:g} | {' | '.join(told_of(rows[way]) for way in ways)} |", flush=True)
    pixels.CLEAR = 4.0


def constants(seeds: range, folder: Path) -> None:
    """Changed pixels of clean scans, and missed hits, with one constant changed at a time."""
    print("| constant | clean, % changed | hits missed, % |\n|---|---|---|")
    for name, values in {
        "OUT": (4.5, 6.0, 8.0),
        "LEAST_OUT": (0.01, 0.02, 0.04),
        "ALONE": (3.0, 4.0, 5.0, 7.0),
        "MOST_TOGETHER": (1, 2, 3, 4),
        "RING_NOISE": (2.0, 3.0, 4.0),
    }.items():
        usual = getattr(pixels, name)
        for value in values:
            setattr(pixels, name, value)
            share, missed = [], []
            for seed in seeds:
                for make in OBJECTS.values():
                    rng = np.random.default_rng([61, seed])
                    counts = counts_of(transmissions(make(rng)), rng, 20000.0)
                    struck = hit(counts, rng, 0.005, "random")
                    off, _ = imported(counts, folder, **INTENSITIES, single_pixels=False)
                    on, _ = imported(counts, folder, **INTENSITIES)
                    share.append(100 * changed(on, off))
                    off, _ = imported(struck, folder, **INTENSITIES, single_pixels=False)
                    on, _ = imported(struck, folder, **INTENSITIES)
                    found = (on.transmission != off.transmission)[struck != counts].mean()
                    missed.append(100 * (1 - found))
            print(f"| {name} {value:g} | {told_of(share, 4)} | {told_of(missed, 2)} |", flush=True)
        setattr(pixels, name, usual)


def air(seeds: range, folder: Path) -> None:
    print("| object | air reads | told | warned | largest deviation from right flats, % |")
    print("|" + "---|" * 5)
    for name, make in OBJECTS.items():
        for level in (0.67, 1.5, 3.0):
            off, read, warned = [], [], 0
            for seed in seeds:
                rng = np.random.default_rng([61, seed])
                counts = counts_of(transmissions(make(rng)), rng, 20000.0)
                right, _ = imported(counts, folder, **INTENSITIES)
                wrong = {"values": "intensities", "white": FREE / level}
                _, told = imported(counts, folder, **wrong)
                warned += any("images.air: auto" in doubt for doubt in told.doubts)
                line = next(note for note in told.notes if note.startswith("air reads"))
                read.append(float(line.split()[2].rstrip(",")))
                auto, _ = imported(counts, folder, **wrong, air="auto")
                ratio = auto.transmission / np.maximum(right.transmission, 1e-9)
                off.append(100 * float(np.abs(np.median(ratio, axis=(1, 2)) - 1).max()))
            print(f"| {name} | {level} | {told_of(read)} | {warned} | {told_of(off)} |", flush=True)


def falls(seeds: range, folder: Path) -> None:
    """Flats with and without the fall-off: who is warned, and what ``air: auto`` makes of it."""
    circle = Circle.model_validate(GEOMETRY).views(ImageFacts(VIEWS, PIXELS, PIXELS))
    beam = fall_off(circle.geometry[[0]])
    beam = beam / beam.max()
    print("| object | photons | level | right: warned | lacking: warned | auto off by at most, % |")
    print("|" + "---|" * 6)
    for name, make in OBJECTS.items():
        for photons, level in ((None, 1.0), (20000.0, 1.0), (1000.0, 1.0), (20000.0, 1.5)):
            warned, off = [0, 0], []
            for seed in seeds:
                rng = np.random.default_rng([61, seed])
                counts = counts_of(transmissions(make(rng)) * beam, rng, photons)
                np.save(folder / "right.npy", FREE * beam[None])
                keys = {"values": "intensities", "white": FREE / level}
                flats = [{"path": str(folder / "right.npy")}]
                right, fine = imported(counts, folder, values="intensities", flats=flats)
                _, told = imported(counts, folder, **keys)
                auto, _ = imported(counts, folder, **keys, air="auto")
                for index, one in enumerate((fine, told)):
                    warned[index] += any("fall" in doubt for doubt in one.doubts)
                ratio = auto.transmission / np.maximum(right.transmission, 1e-9)
                off.append(100 * float(np.abs(np.median(ratio, axis=0) - 1).max()))
            cells = f"{photons or 'all'} | {level} | {warned[0]} | {warned[1]} | {told_of(off)}"
            print(f"| {name} | {cells} |", flush=True)


def rings(seeds: range, folder: Path) -> None:
    """Relative errors of ``fdk`` with gains of pixels that the flats miss, and of clean scans."""
    print("| object | gains off by, % | left | width 5 | width 9 | width 21 |\n|" + "---|" * 6)
    for name in ("parts", "balls", "screws"):
        for off in (0.0, 0.01, 0.03):
            rows: dict[int, list[float]] = {width: [] for width in (0, 5, 9, 21)}
            for seed in seeds:
                rng = np.random.default_rng([61, seed])
                made = OBJECTS[name](rng)
                gains = 1 + off * rng.standard_normal((PIXELS, PIXELS))
                counts = counts_of(transmissions(made) * gains, rng, 20000.0)
                for width, errors in rows.items():
                    keys = {"rings": {"width": width}} if width else {}
                    scan, _ = imported(counts, folder, **INTENSITIES, **keys)
                    errors.append(error(scan, truth(made)))
            cells = " | ".join(told_of(errors) for errors in rows.values())
            print(f"| {name} | {100 * off:g} | {cells} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "what", choices=("clean", "hits", "starved", "constants", "air", "falls", "rings")
    )
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=1, help="the first seed")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        globals()[chosen.what](range(chosen.first, chosen.first + chosen.seeds), Path(place))
