"""What corrections of beam hardening and metal are worth on the polychromatic scans of the zoo.

python benchmarks/zoo_corrections.py --seeds 1 2 3
python benchmarks/zoo_corrections.py --cases foot "spine, bright"

Errors are RMSE, % of the mu of the densest material that is no metal, at the best pass of
non-negative SART with relaxation 0.3, chosen by the truth; surroundings are removed where the
object reaches beyond the grid. "Near" is within 3 mm of the object, without metal; "at metal" are
those of its voxels within 8 mm of metal. "None": line integrals as they are measured. "One":
linearised for the main material. "Two": also for bone, which a first volume shows. "NMAR": these
line integrals with the metal replaced. Density: attenuation of the metal that is put back, relative
to that of the metal named, as twinct states it; it is marked below 0.85 and above 1.15.
"""

import argparse
import warnings
from typing import Any

import numpy as np
from scipy import ndimage
from zoo import without_rest
from zoo_scans import HELD_OUT, MATERIALS, TUNING, Made, spectrum

from twinct.core.errors import InputError
from twinct.recon import sart, without_metal
from twinct.xray.hardening import Hardening
from twinct.xray.response import PhotonResponse
from twinct.xray.spectrum import PhotonSpectrum

PASSES, RELAXATION, FIRST = 12, 0.3, 3
AT_METAL_MM = 8.0
DENSE = {"spine": "bone", "foot": "bone"}
METAL = {"spine": ("muscle", "bone", "titanium"), "board": ("laminate", "aluminium", "copper")}
"""Tissue, bone and metal for NMAR, by object."""
WAYS = ("none", "one", "two", "NMAR")


class Corrected:
    """One polychromatic scan and its corrections."""

    def __init__(self, case, seed, size):
        """Draw the scan, and find the voxels at metal."""
        self.made = made = Made(case, seed, size)
        self.object = case.name.split(",")[0]
        energies, weights, self.energy = spectrum(case.main)
        self.known = (
            PhotonSpectrum(energies, weights / energies, absolute=False),
            PhotonResponse.integrating(),
        )
        far = ndimage.distance_transform_edt(~made.metal) * made.grid.voxel[0]
        self.at_metal = made.near & (far <= AT_METAL_MM) if made.metal.any() else None

    def alone(self, p):
        """Line integrals of the grid."""
        return without_rest(self.made, p) if self.made.case.truncated else p

    def two(self):
        """Line integrals corrected for the main material and bone."""
        base, dense = MATERIALS[self.made.case.main], MATERIALS[DENSE[self.object]]
        keys = {"iterations": FIRST, "relaxation": RELAXATION}
        volume = sart(self.made.A, self.made.p, **keys).array
        low, high = (one.mu_per_mm(self.energy) for one in (base, dense))
        share = np.clip(2 * (volume - low) / (high - low) - 0.5, 0, 1).astype(np.float32)
        paths = self.made.A(share)
        hardening = Hardening(*self.known, [base, dense], self.energy, float(paths.max()))
        return np.stack([hardening.correct(*one) for one in zip(self.made.raw, paths, strict=True)])

    def errors(self, p, metal=None):
        """The least errors near the object, and at metal."""
        found = []

        def judged(step):
            if step.update + 1 == step.updates:
                off = np.square(step.volume - self.made.truth, dtype=np.float64)
                places = [self.made.near, self.at_metal]
                found.append([np.nan if at is None else np.sqrt(off[at].mean()) for at in places])

        keys = {"iterations": PASSES, "relaxation": RELAXATION, "nonnegative": True}
        sart(self.made.A, p, callback=judged, **keys)
        return 100 * np.min(found, axis=0) / self.made.mu

    def all(self):
        """Errors by way, and the density that NMAR states."""
        made, density = self.made, None
        p = {"none": made.raw, "one": made.p}
        if self.object in DENSE:
            p["two"] = self.two()
        found = {way: self.errors(self.alone(one)) for way, one in p.items()}
        if self.object in METAL:
            names = dict(zip(("tissue", "bone", "metal"), METAL[self.object], strict=True))
            mus: dict[str, Any] = {
                key: MATERIALS[name].mu_per_mm(self.energy) for key, name in names.items()
            }
            try:
                done = without_metal(made.A, self.alone(p.get("two", p["one"])), **mus)
                found["NMAR"] = self.errors(done.line_integrals)
                density = done.density_rel
            except InputError as error:
                print(f"{made.case.name}: NMAR refuses: {error.problems[0][:120]}")
        return found, density


def spread(values):
    """Mean and standard deviation in words."""
    return f"{np.mean(values):.2f} ± {np.std(values):.2f}" if len(values) else "-"


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--cases", nargs="+", help="names of scans")
    parser.add_argument("--size", type=int, help="voxels along an edge")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    options = parser.parse_args()
    print(f"| scan | where | {' | '.join(WAYS)} | density |\n|---|---|{'---|' * 5}")
    for case in (*TUNING, *HELD_OUT):
        if case.main is None or (options.cases and case.name not in options.cases):
            continue
        told = [Corrected(case, seed, options.size).all() for seed in options.seeds]
        densities = [f"{density:.2f}" for _, density in told if density is not None]
        for k, where in enumerate(("near", "at metal")):
            cells = [spread([found[way][k] for found, _ in told if way in found]) for way in WAYS]
            if "nan" not in cells[0]:
                last = ", ".join(densities) if k else ""
                print(f"| {case.name} | {where} | {' | '.join(cells)} | {last} |", flush=True)


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        main()
