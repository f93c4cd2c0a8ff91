"""Whether a diagnosis names the cause that was injected into a scan.

    python benchmarks/bench_diagnosis.py [--seeds 100 105] [--causes roll air]

Each cause is injected alone into scans of random objects (``random_objects.py``): all causes for
each seed, with a size that makes the error of a SART volume 1.3 to 3 times that of the clean scan.
Order and sense of the views have no size. Prints one line for each scan, then a table: how often
the first named cause is right, how often one of the first two is, what was named instead, and how
many clean scans had a cause named. Seeds below 100 were used to tune, and clean scans from 300 to
336.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from random_objects import FAMILIES, RandomObject, ellipsoid, random_object, rotation
from scipy import ndimage

from twinct.calibration import aligned
from twinct.core.errors import InputError
from twinct.diagnosis import diagnosed
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector, sart
from twinct.recon.few_photons import integrals_of_photons

SPAN_MM, FINER, SAMPLES = 100.0, 2.6, 2
WORSE = 1.3, 3.0
"""Range of the error relative to that of the clean scan."""


@dataclass(frozen=True, eq=False)
class Injected:
    """What the detector saw, and what is believed of it.

    Attributes:
        p: line integrals, (views, rows, columns).
        A: the projector, as believed.
        photons: photons of a pixel, (views,).
        taken: geometry at which it was taken, if it is not as believed.
        denser: attenuation of the object relative to the clean scan's.
    """

    p: np.ndarray
    A: Projector
    photons: np.ndarray
    taken: ScanGeometry | None = None
    denser: float = 1.0


class Bench:
    """A random object, its scan without errors, and scans with one error each."""

    def __init__(self, seed: int) -> None:
        """Draw object, views and photons."""
        rng = np.random.default_rng([seed, 61])
        self.seed, self.rng = seed, rng
        self.family = list(FAMILIES)[seed % len(FAMILIES)]
        size, self.views = int(rng.integers(44, 60)), int(rng.integers(60, 100))
        self.number = float(np.exp(rng.uniform(np.log(3e3), np.log(1e6))))
        self.most = rng.uniform(1.5, 4.0)
        self.made = random_object(rng, self.family)
        self.grid = VolumeGrid([size] * 3, SPAN_MM * rng.uniform(1.02, 1.15) / size)
        path = str(rng.choice(["circle", "circle", "sinusoid"]))
        self.geometry = _views(rng, path, self.views, size)
        fine_mm = float(self.grid.voxel[0]) / FINER
        self.number_fine = int(np.ceil(SPAN_MM / fine_mm)) + 2
        place = Pose.from_matrix(rng.uniform(-0.5, 0.5, size=3) * fine_mm, rotation(rng))
        self.fine = VolumeGrid([self.number_fine] * 3, fine_mm, place)
        self.path = path

    @cached_property
    def metal(self) -> RandomObject:
        """Metal balls in the object."""
        rng = np.random.default_rng([self.seed, 7])
        places = [rng.uniform(-0.35, 0.35, size=3) for _ in range(3)]
        return RandomObject("metal", [ellipsoid(c, [rng.uniform(0.05, 0.1)] * 3) for c in places])

    def lines(self, geometry: ScanGeometry, made: RandomObject) -> np.ndarray:
        """Return exact line integrals of many rays a pixel, unscaled."""
        panel = geometry.panel
        rays = Panel(
            panel.rows * SAMPLES,
            panel.columns * SAMPLES,
            panel.pitch_u / SAMPLES,
            panel.pitch_v / SAMPLES,
        )
        dense = ScanGeometry(geometry.source, geometry.detector, geometry.u, geometry.v, rays)
        return Projector(dense, self.fine)(self._fine(made))

    def _fine(self, made: RandomObject) -> np.ndarray:
        key = made.family
        kept = self.__dict__.setdefault("_volumes", {})
        if key not in kept:
            kept[key] = made.on(self.fine, SPAN_MM / 2)
        return kept[key]

    @cached_property
    def exact(self) -> np.ndarray:
        """Line integrals of the object at the true geometry."""
        return self.lines(self.geometry, self.made)

    @cached_property
    def mu(self) -> float:
        """Attenuation of the densest part, 1/mm."""
        return self.most / float(np.percentile(self.exact[::8], 99.5))

    @cached_property
    def truth(self) -> np.ndarray:
        return self.made.on(self.grid, SPAN_MM / 2, 3) * np.float32(self.mu)

    @cached_property
    def beside_metal(self) -> np.ndarray:
        """Voxels that are not next to metal: there, a wrong value of the metal is no error."""
        metal = self.metal.on(self.grid, SPAN_MM / 2, 3) > 0
        return ~ndimage.binary_dilation(metal, iterations=2)

    def seen(
        self, beam: np.ndarray, A: Projector | None = None, *, readout: float = 0.0
    ) -> Injected:
        """Return the scan of transmissions of many rays a pixel."""
        A = A or Projector(self.geometry, self.grid)
        views, rows, columns = A.range_shape
        pixels = beam.reshape(views, rows, SAMPLES, columns, SAMPLES).mean(axis=(2, 4))
        rng = np.random.default_rng([self.seed, 8])
        counts = rng.poisson(np.maximum(pixels, 0) * self.number) / self.number
        if readout:
            counts = counts + rng.normal(0, readout, counts.shape)
            p = -np.log(np.maximum(counts, readout / 4))
        else:
            p = integrals_of_photons(counts, self.number)
        return Injected(p.astype(np.float32), A, np.full(views, self.number))

    @cached_property
    def clean(self) -> Injected:
        return self.seen(np.exp(-self.mu * self.exact))

    def error(self, scan: Injected, where: np.ndarray | bool = True) -> float:
        """Return the error of a SART volume near the object, relative to its attenuation.

        A motion of the whole scene and its scale change no image: the truth follows them.
        """
        truth = self.truth if scan.taken is None else self.moved_truth(scan.taken)
        away = ndimage.distance_transform_edt(truth < 0.02 * self.mu)
        near = (np.asarray(away) <= 3) & where
        x = sart(scan.A, scan.p, iterations=4, relaxation=0.5, nonnegative=True).array
        return float(np.sqrt(np.mean((x / scan.denser - truth)[near] ** 2))) / self.mu

    def moved_truth(self, taken: ScanGeometry) -> np.ndarray:
        """Return the truth where the believed geometry puts it, as closely as a motion can."""
        points = SPAN_MM / 3 * np.concatenate([np.eye(3), -np.eye(3), [[0.7, 0.7, -0.7]]])
        found = aligned(self.geometry, taken, points)
        corners = np.eye(4)[:, 1:] * SPAN_MM
        middle = points.mean(axis=0)
        to = found.motion.apply(corners + (found.scale - 1) * (corners - middle))
        turn = (to[1:] - to[0]).T / (SPAN_MM * found.scale)
        grid = VolumeGrid(
            self.grid.shape, self.grid.voxel * found.scale, Pose.from_matrix(to[0], turn)
        )
        return self.made.on(grid, SPAN_MM / 2, 3) * np.float32(self.mu * found.scale)


HARDER = 1.5
"""Attenuation of metal in the softer half of the beam, relative to its geometric mean."""

READOUT = 0.003
"""Noise of the dark image relative to air: 8 of 2700 photons."""

Size = Callable[[Bench, float], Injected]


def _stated(bench: Bench, geometry: ScanGeometry) -> Injected:
    """Return a scan taken at a geometry, but stated to be taken at another."""
    scan = bench.seen(np.exp(-bench.mu * bench.lines(geometry, bench.made)))
    return replace(scan, taken=geometry)


def offset(bench: Bench, size: float) -> Injected:
    g = bench.geometry
    return _stated(bench, replace(g, detector=g.detector + size * g.panel.pitch_u * g.u))


def roll(bench: Bench, size: float) -> Injected:
    g, turn = bench.geometry, np.radians(size)
    u, v = np.cos(turn) * g.u + np.sin(turn) * g.v, np.cos(turn) * g.v - np.sin(turn) * g.u
    return _stated(bench, replace(g, u=u, v=v))


def tilt(bench: Bench, size: float) -> Injected:
    """Lean of the panel, or of the axis away from the source."""
    g, turn, n = bench.geometry, np.radians(5 * size), bench.geometry.normal
    if bench.seed % 3 == 0:
        return _stated(bench, replace(g, v=np.cos(turn) * g.v + np.sin(turn) * n))
    if bench.seed % 3 == 1:
        return _stated(bench, replace(g, u=np.cos(turn) * g.u + np.sin(turn) * n))
    lean = np.radians(size)

    def turned(x: np.ndarray) -> np.ndarray:
        along, up = (x * n).sum(1)[:, None], (x * g.v).sum(1)[:, None]
        side = x - along * n - up * g.v
        return (
            side
            + (np.cos(lean) * along - np.sin(lean) * up) * n
            + (np.sin(lean) * along + np.cos(lean) * up) * g.v
        )

    return _stated(
        bench, replace(g, source=turned(g.source), detector=turned(g.detector), v=turned(g.v))
    )


def distances(bench: Bench, size: float) -> Injected:
    """Move panel or object along the beam."""
    g = bench.geometry
    if bench.seed % 2:
        return _stated(bench, replace(g, detector=g.detector - size * 5 * g.normal))
    return _stated(
        bench,
        replace(
            g, source=g.source + size * 3 * g.normal, detector=g.detector + size * 3 * g.normal
        ),
    )


def angles(bench: Bench, size: float) -> Injected:
    """Turn by more than stated."""
    g = bench.geometry
    views = np.linspace(-1, 1, len(g)) * np.radians(size)
    parts = [
        Pose.from_euler((0, 0, 0), (0, 0, float(np.degrees(a)))) @ one
        for a, one in zip(views, g, strict=True)
    ]
    return _stated(bench, ScanGeometry.joined(parts))


def motion(bench: Bench, size: float) -> Injected:
    """Drift, step or slow oscillation of the object along a direction."""
    rng, g = np.random.default_rng([bench.seed, 9]), bench.geometry
    t = np.linspace(0, 1, len(g))
    course = [
        t,
        (t > rng.uniform(0.3, 0.7)).astype(float),
        np.sin(2 * np.pi * (rng.uniform(1, 2.5) * t + rng.uniform())),
    ][bench.seed // 2 % 3]
    way = rng.normal(size=3)
    shift = size * (course - course.mean())[:, None] * way / np.linalg.norm(way)
    return _stated(bench, replace(g, source=g.source - shift, detector=g.detector - shift))


def air(bench: Bench, size: float) -> Injected:
    sign = 1 if bench.seed % 2 else -1
    return bench.seen(np.exp(-bench.mu * bench.exact + sign * 0.05 * size))


def hardening(bench: Bench, size: float) -> Injected:
    p = bench.mu * bench.exact
    soft, hard = 1 + size, 1 / (1 + size)
    return bench.seen((np.exp(-soft * p) + np.exp(-hard * p)) / 2)


def scatter(bench: Bench, size: float) -> Injected:
    p = bench.mu * bench.exact
    beam = np.exp(-p)
    wide = ndimage.gaussian_filter(beam * p, (0, p.shape[1] / 5, p.shape[2] / 5))
    return bench.seen(beam + 0.1 * size * wide)


def metal(bench: Bench, size: float) -> Injected:
    """Add balls of metal, so many times denser than the object, which harden the beam."""
    t, m = bench.mu * bench.exact, size * bench.mu * bench.lines(bench.geometry, bench.metal)
    return bench.seen((np.exp(-t - HARDER * m) + np.exp(-t - m / HARDER)) / 2)


def starved(bench: Bench, size: float, readout: float = READOUT) -> Injected:
    """Make the object so dense that few photons are left, and read them out with noise."""
    denser = 1 + size
    beam = np.exp(-denser * bench.mu * bench.exact)
    return replace(bench.seen(beam, readout=readout), denser=denser)


def saturated(bench: Bench, size: float) -> Injected:
    """Clip bright pixels."""
    clean = bench.clean
    return replace(clean, p=np.maximum(clean.p, np.float32(0.2 * size)))


def truncation(bench: Bench, size: float) -> Injected:
    """Use a narrower panel."""
    g = bench.geometry
    wide = g.panel.columns
    cut = min(int(round(wide * 0.1 * size)), wide * 3 // 8)
    panel = replace(g.panel, columns=wide - 2 * cut)
    part = replace(g, panel=panel)
    beam = np.exp(-bench.mu * bench.exact[:, :, cut * SAMPLES : (wide - cut) * SAMPLES])
    return bench.seen(beam, Projector(part, bench.grid))


def sense(bench: Bench, size: float) -> Injected:
    """Turn the other way."""
    clean = bench.clean
    return replace(clean, A=Projector(bench.geometry[::-1], bench.grid)) if size else clean


def order(bench: Bench, size: float) -> Injected:
    """Read files by their names: 0, 1, 10, 11, ..., 2, 20."""
    clean = bench.clean
    names = sorted(range(len(clean.p)), key=str)
    return replace(clean, p=clean.p[names]) if size else clean


CAUSES: dict[str, Size] = {
    "offset": offset,
    "roll": roll,
    "tilt": tilt,
    "distances": distances,
    "angles": angles,
    "motion": motion,
    "air": air,
    "hardening": hardening,
    "scatter": scatter,
    "metal": metal,
    "starved": starved,
    "saturated": saturated,
    "truncation": truncation,
    "sense": sense,
    "order": order,
}

NAMED = {
    "hardening": "beam",
    "scatter": "beam",
    "sense": "order",
    "starved": "pixels",
    "saturated": "pixels",
}
"""Group of a cause in the diagnosis, if it has another name."""

MOST = {
    "roll": 10.0,
    "tilt": 4.0,
    "angles": 10.0,
    "air": 22.0,
    "distances": 15.0,
    "truncation": 2.5,
    "metal": 60.0,
}
"""Sizes beyond which nobody would state a geometry: 10 deg, air that reads three times too much."""

SIZELESS = ("sense", "order")


def sized(bench: Bench, name: str) -> tuple[Injected, float, float] | None:
    """Return a scan whose error is some times the clean one, its size and that ratio."""
    make = CAUSES[name]
    where = bench.beside_metal if name == "metal" else True
    clean = bench.error(bench.clean, where)
    if name in SIZELESS:
        scan = make(bench, 1.0)
        return scan, 1.0, bench.error(scan) / clean
    wish = float(np.exp(np.random.default_rng([bench.seed, 10]).uniform(*np.log(WORSE))))
    wish = min(max(wish, WORSE[0] * 1.05), WORSE[1] * 0.95)
    low, high, size, best = 0.0, np.inf, 1.0, None
    for _ in range(8):
        if size > MOST.get(name, np.inf):
            high, size = size, (low + min(size, MOST[name])) / 2
            continue
        try:
            scan = make(bench, size)
        except (ValueError, InputError):  # no such geometry
            high, size = size, (low + size) / 2
            continue
        if name == "starved":
            clean = bench.error(starved(bench, size, 0.0))
        ratio = bench.error(scan, where) / clean
        if WORSE[0] <= ratio <= WORSE[1]:
            if best is None or abs(np.log(ratio / wish)) < abs(np.log(best[2] / wish)):
                best = scan, size, ratio
            if abs(np.log(ratio / wish)) < 0.15:
                return best
        low, high = (size, high) if ratio < wish else (low, size)
        guess = size * np.sqrt((wish**2 - 1) / max(ratio**2 - 1, 0.02))
        size = (
            float(guess)
            if low < guess < high
            else (2 * low if np.isinf(high) else (low + high) / 2)
        )
    return best


def scans(
    seeds: Iterator[int], causes: list[str]
) -> Iterator[tuple[Bench, str, Injected, float, float]]:
    for seed in seeds:
        bench = Bench(seed)
        yield bench, "clean", bench.clean, 0.0, 1.0
        for name in causes:
            if (found := sized(bench, name)) is not None:
                yield bench, name, *found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(100, 105))
    parser.add_argument("--causes", nargs="*", default=list(CAUSES))
    given = parser.parse_args()
    table: dict[str, Counter[str]] = defaultdict(Counter)
    two: Counter[str] = Counter()
    for bench, name, scan, size, ratio in scans(iter(range(*given.seeds)), given.causes):
        begin = time.perf_counter()
        found = diagnosed(scan.A, scan.p, photons=scan.photons)
        took = time.perf_counter() - begin
        names = [one.name for one in found.named]
        right = NAMED.get(name, name)
        table[name][names[0] if names else "none"] += 1
        two[name] += right in names[:2]
        shares = ", ".join(
            f"{one.name} {one.share:.2f} {one.explained:.3f}" for one in found.all[:4]
        )
        print(
            f"{bench.seed:4d} {bench.family:9s} {bench.path:8s} {name:10s} size {size:6.3f} "
            f"error x {ratio:4.2f}  named {', '.join(names) or '-':24s} ({shares}) {took:.1f} s",
            flush=True,
        )
    right = all_ = of_two = 0
    for name, counts in table.items():
        wanted = NAMED.get(name, "none" if name == "clean" else name)
        total = sum(counts.values())
        others = ", ".join(f"{k} {n}" for k, n in counts.most_common())
        print(
            f"{name:10s} first {counts[wanted]:3d} of {total}, first two {two[name]:3d}: {others}"
        )
        if name != "clean":
            right, all_, of_two = right + counts[wanted], all_ + total, of_two + two[name]
    if all_:
        print(f"first right {right / all_:.1%}, first two {of_two / all_:.1%} of {all_}")


def _views(rng: np.random.Generator, path: str, views: int, size: int) -> ScanGeometry:
    """Draw the geometry: the panel sees the whole ball in each view."""
    sod = SPAN_MM * rng.uniform(2.5, 6)
    sdd = sod * rng.uniform(1.3, 2)
    angle = 2 * np.pi * np.arange(views) / views + rng.uniform(0, 2 * np.pi)
    height, waves = np.radians(rng.uniform(10, 30)), {"circle": 0, "sinusoid": 3}[path]
    lean = height * np.cos(waves * angle) if waves else np.zeros(views)
    out = np.stack([np.cos(lean) * np.cos(angle), np.cos(lean) * np.sin(angle), np.sin(lean)], 1)
    u = np.stack([-np.sin(angle), np.cos(angle), np.zeros(views)], axis=1)
    wide = 1.08 * SPAN_MM * sdd / np.sqrt(sod**2 - (SPAN_MM / 2) ** 2)
    pixels = round(size * rng.uniform(0.95, 1.25))
    panel = Panel(pixels, pixels, wide / pixels, wide / pixels)
    return ScanGeometry(sod * out, (sod - sdd) * out, u, np.cross(out, u), panel)


if __name__ == "__main__":
    main()
