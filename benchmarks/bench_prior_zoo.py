"""What ``prior_tv`` with its defaults is worth on objects that are no skulls: ten changes.

    python benchmarks/bench_prior_zoo.py --out out/prior_zoo
    python benchmarks/bench_prior_zoo.py --out out/prior_zoo --cases "tooth, lesion" --size 32

Objects of the zoo, scanned twice with photon noise: earlier with a full circle of 400 views, moved
by 1 mm and turned by 1 degree; and now with few views and a change: a lesion, a screw, or a
resection. Pixels and voxels of the earlier scan are half as large, and a pixel has a quarter of the
photons. Its volume, by ``fast``, is the prior, which ``prior_tv`` registers itself. With ``--poor``
it has 120 views in pixels and voxels as large as those of now. Errors are
those of the zoo, near the object as it is now. ``fast`` has the best of its strengths, chosen
by the truth. The contrast is that of the change's core, two voxels within
its border, of the truth's; it is judged where the core is at least 10 voxels wide with its border
and the change exceeds five times the noise of the volume without a prior. With ``--perfect`` the
prior is the earlier scan's truth in its voxels: the bound of any prior.
"""

import argparse
import json
import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import zoo_objects as objects
from scipy import ndimage
from scipy.spatial.transform import Rotation
from zoo_scans import Case, Made
from zoo_shapes import BOX

from twinct.recon import Projector, fast, prior_tv
from twinct.recon.volume import Volume

STRENGTHS = tuple(1e-4 * 3.0**k for k in range(-3, 4))
"""Strengths of ``fast`` without a prior; the search goes on while they help."""
ITERATIONS = 24
MOVED_MM, TURNED_DEG = (0.6, -0.5, 0.62), (0.5, -0.6, 0.62)
EARLIER_VIEWS, FINER = 400, 2
"""Views of the earlier scan, and its pixels and voxels along one of now."""
POOR_VIEWS = 120
VOXELS = 48
"""Voxels along an edge to which the views belong; smaller grids have fewer of them."""
WIDE, SIGMAS = 10, 5.0


@dataclass(frozen=True)
class Change:
    """An object of the zoo and what is new in it; shapes that come later replace earlier ones."""

    name: str
    draw: object
    new: tuple
    path: str = "circle"
    views: int = 40
    photons: float = 1e4
    main: str | None = None


def lesion(centre, radius, material):
    """A ball."""
    return (objects.ball(centre, radius, material),)


def screw(start, end, radius=1.8):
    """A rod of titanium with a head."""
    return objects.rod(start, end, radius, "titanium"), objects.ball(start, 3.0, "titanium")


def resection(centre, half, material):
    """A box of what fills the gap."""
    return (objects.Shape(BOX, centre, half, material, None),)


CASES = (
    Change("tissue, lesion", objects.tissue, lesion((4, -6, 3), 10.5, "water")),
    Change("gradients, lesion", objects.gradients, lesion((-5, 4, 0), 10.5, "bone"), "saddle"),
    Change("foot, screw", objects.foot, screw((-9, -4, 0), (9, 6, 1)), "arc", 30, 3e4),
    Change("foot, resection", objects.foot, resection((0, -17, 0), (9, 6, 8), "muscle")),
    Change("tooth, lesion", objects.tooth, lesion((0, 2, -10), 10.5, "muscle"), "cap", 30, 3e4),
    Change("tooth, resection", objects.tooth, resection((8, 0, 4), (8, 8, 14), "muscle")),
    Change("casting, resection", objects.casting, resection((4, 0, 0), (11, 11, 11), "air")),
    Change("foam, lesion", objects.foam, lesion((0, 3, -2), 10.5, "water"), "sphere", 30, 3e4),
    Change("mixture, screw", objects.mixture, screw((-12, 3, 0), (12, -4, 6)), "helix"),
    Change("trabecular, lesion", objects.trabecular, lesion((2, 0, 4), 10.5, "water"), "arc"),
)


def moved(shape):
    """A shape of the object that lay elsewhere earlier."""
    turn = Rotation.from_euler("xyz", TURNED_DEG, degrees=True).as_matrix()
    own = np.eye(3) if shape.rotation is None else np.asarray(shape.rotation)
    centre = tuple(turn @ np.asarray(shape.centre, float) + MOVED_MM)
    return replace(shape, centre=centre, rotation=turn @ own)


def scans(change, seed, size, poor, folder):
    """Earlier and present scan, and the present object's truth before the change; made once."""
    way = "poor" if poor else "full"
    kept = folder / f"{change.name.replace(', ', '_')}_{seed}_{size}_{way}.pkl"
    if not kept.exists():
        told = drawn(change, seed, size, poor)
        for one in told[:2]:
            vars(one).update(A=None, case=None)  # neither can be stored
        kept.write_bytes(pickle.dumps(told))
    before, now, without = pickle.loads(kept.read_bytes())
    for one in (before, now):
        one.A = Projector(one.geometry, one.grid)
    return before, now, without


def drawn(change, seed, size, poor):
    """Draw both scans."""
    shapes = change.draw(np.random.default_rng([seed, *change.name.encode()]))

    def made(name, shapes, views, path, finer=1):
        views, photons = round(views * size / VOXELS), change.photons / finer**2
        case = Case(name, lambda rng: shapes, path, views, photons, main=change.main)
        return Made(case, seed, finer * size)

    views, finer = (POOR_VIEWS, 1) if poor else (EARLIER_VIEWS, FINER)
    before = made("earlier", [moved(one) for one in shapes], views, "circle", finer)
    now = made("now", [*shapes, *change.new], change.views, change.path)
    without = made("without", shapes, 4, change.path)
    return before, now, without.truth * (now.mu > 0)


class Judge:
    """Error near the object, and contrast of the change."""

    def __init__(self, now, without):
        """Find the change's core."""
        self.now, self.without = now, without
        step = now.truth - without
        inner = ndimage.binary_erosion(np.abs(step) > 0.5 * np.abs(step).max(), iterations=2)
        self.core = inner & (now.truth <= 1.01 * now.mu)
        widths = [np.ptp(axis) + 5 if axis.size else 0 for axis in np.nonzero(self.core)]
        self.wide, self.size = (
            min(widths) >= WIDE,
            float(np.abs(step[inner]).sum() / max(inner.sum(), 1)),
        )

    def contrast(self, volume):
        """Share of the change's contrast; None where it is not judged."""
        if not self.wide:
            return None
        step = (self.now.truth - self.without)[self.core].mean()
        return float((volume - self.without)[self.core].mean() / step)

    def noise(self, volume):
        """Deviation from the truth in the core, less its mean."""
        return float((volume - self.now.truth)[self.core].std()) if self.wide else 0.0


def best_plain(now, judge):
    """The best of ``fast``: from the middle strength on, as long as the error falls."""
    found = {}

    def error(k):
        if k not in found:
            volume = fast(now.A, now.p, passes=ITERATIONS, strength=STRENGTHS[k]).array
            found[k] = now.error(volume), judge.contrast(volume), judge.noise(volume)
        return found[k][0]

    k = len(STRENGTHS) // 2
    for way in (-1, 1):
        while 0 <= k + way < len(STRENGTHS) and error(k + way) < error(k):
            k += way
    k, (least, contrast, noise) = min(found.items(), key=lambda one: one[1][0])
    told = {"error": least, "contrast": contrast, "noise": noise}
    return told | {"strength": STRENGTHS[k]}


def measure(change, seed, size, ways, folder):
    """The figures of one case."""
    poor = "poor" in ways
    before, now, without = scans(change, seed, size, poor, folder)
    judge, found = Judge(now, without), {}
    if "plain" in ways:
        found["plain"] = best_plain(now, judge)
    for way in {"prior", "poor", "perfect"} & set(ways):
        array = before.truth.astype(np.float32)
        if way != "perfect":
            photons = change.photons / (1 if poor else FINER**2)
            array = fast(before.A, before.p, photons=photons).array
        volume = prior_tv(now.A, now.p, Volume(array, before.grid), photons=change.photons)
        judged = volume.extras["left_out"]
        told = {"share": judged.share, "left out": judged.ratio}
        error = now.error(volume.array)
        found[way] = {"error": error, "contrast": judge.contrast(volume.array)} | told
        found[way] |= {"wide": bool(judge.wide), "size": judge.size}
    return found


def main():
    """Measure what is not there yet, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", nargs="+", help="names of cases")
    parser.add_argument("--size", type=int, default=48, help="voxels along an edge")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--poor", action="store_true", help="a short earlier scan")
    parser.add_argument("--perfect", action="store_true", help="the truth as prior")
    parser.add_argument("--again", action="store_true", help="the volumes with a prior anew")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / f"prior_{options.size}.json"
    known = json.loads(path.read_text()) if path.exists() else {}
    ratios, contrasts = [], []
    way = "perfect" if options.perfect else "poor" if options.poor else "prior"
    for seed in options.seeds:
        for change in CASES:
            if options.cases and change.name not in options.cases:
                continue
            key = f"{change.name}, seed {seed}"
            one = known.setdefault(key, {})
            if options.again:
                one.pop(way, None)
            missing = [name for name in ("plain", way) if name not in one]
            if missing:
                one |= measure(change, seed, options.size, missing, options.out)
                path.write_text(json.dumps(known, indent=1))
            plain, ours = one["plain"], one[way]
            ratios.append(ours["error"] / plain["error"])
            told = "not judged"
            if ours["wide"] and ours["size"] > SIGMAS * plain["noise"]:
                contrasts.append(ours["contrast"])
                told = f"{100 * ours['contrast']:.0f} %"
            print(
                f"{key}: prior_tv {ours['error']:.2f} %, fast {plain['error']:.2f} % "
                f"({plain['strength']:.2g}): {ratios[-1]:.2f} x; "
                f"contrast {told}; share {ours['share']:g}, residual of left-out views "
                f"{ours['left out']:.3f} x",
                flush=True,
            )
    print(f"median {np.median(ratios):.2f} x, at most {max(ratios):.2f} x", end="; ")
    print("contrasts " + ", ".join(f"{100 * one:.0f} %" for one in contrasts))


if __name__ == "__main__":
    main()
