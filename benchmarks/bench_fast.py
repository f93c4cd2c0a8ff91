"""``fast`` of an older checkout against this one, on one scan of the paper's skull.

python benchmarks/bench_fast.py OLDER_CHECKOUT --out out/fast
python benchmarks/bench_fast.py OLDER_CHECKOUT --out out/fast --set passes=1

The scan is made by this checkout, with executed poses and the mesh engine, and kept in OUT. Each
checkout reconstructs in a process of its own, with one thread, after a few views that load its
kernels; ``--set`` is for this checkout alone. Printed: processor seconds, their ratio, and the
errors within 3 mm of bone and in the region that every view sees, judged by this checkout.
"""

import argparse
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]

RUNNER = """
import pickle, sys, time
from pathlib import Path
import numpy as np
from twinct.core.threads import limit_threads
from twinct.recon import Projector, fast
limit_threads(1)
folder, out, *told = sys.argv[1:]
pairs = (one.split("=") for one in told)
keys = {key: float(value) if "." in value else int(value) for key, value in pairs}
p = np.load(Path(folder) / "p.npy")
geometry, grid, *_ = pickle.loads((Path(folder) / "scan.pickle").read_bytes())
fast(Projector(geometry[:4], grid), p[:4], passes=1)
start = time.process_time()
volume = fast(Projector(geometry, grid), p, **keys)
print(time.process_time() - start)
np.save(out, volume.array)
"""


def make(folder, size, views, photons):
    """Write line integrals, geometry and grid, and truth, region and mu of bone."""
    from twinct.runs import acquire_to_store, truth_of
    from twinct.scan import SimulationBuilder, line_integrals, local_rig
    from twinct.scenario import load_scenario

    factor = 512 / size
    keys = {
        "cell": "{kind: gantry}",
        "xray.engine": "mesh",
        "detector.columns": round(640 / factor),
        "detector.rows": round(480 / factor),
        "detector.pixel_pitch_mm": 0.5 * factor,
        "trajectory.views": views,
        "reconstruction.geometry": "executed",
        "reconstruction.grid": f"{{voxels: {size}, voxel_mm: {0.31 * factor}}}",
    }
    told = [f"{key}={value}" for key, value in keys.items()]
    builder = SimulationBuilder(load_scenario(HERE / "scenarios/paper.yaml", told))
    scan = acquire_to_store(builder, folder / "scan.zarr", local_rig, resume=True).read()
    truth, seen = truth_of(scan, builder), np.asarray(scan.transmission)
    drawn = np.random.default_rng(5).poisson(seen * photons)
    seen = np.maximum(drawn, 0.5).astype(np.float32) / np.float32(photons)
    np.save(folder / "p.npy", line_integrals(seen).astype(np.float32))
    geometry = scan.executed.geometry(scan.scenario.detector.panel)
    judged = truth.volume, truth.region, truth.mu_reference
    (folder / "scan.pickle").write_bytes(pickle.dumps((geometry, truth.grid, *judged)))


def main():
    """Make the scan unless it is there, reconstruct, and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("older", type=Path, help="the older checkout")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--views", type=int, default=200)
    parser.add_argument("--photons", type=float, default=1e4)
    parser.add_argument("--set", action="append", default=[], help="argument of this checkout")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if not (options.out / "scan.pickle").exists():
        make(options.out, options.size, options.views, options.photons)
    from twinct.evaluation import image_figures

    _, grid, truth, region, mu = pickle.loads((options.out / "scan.pickle").read_bytes())
    seconds = {}
    for name, checkout, told in (("old", options.older, []), ("new", HERE, options.set)):
        file = options.out / f"{name}.npy"
        done = subprocess.run(
            [sys.executable, "-c", RUNNER, str(options.out), str(file), *told],
            env=os.environ | {"PYTHONPATH": str(checkout.resolve() / "src")},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        seconds[name] = float(done.stdout)
        found = image_figures(np.load(file), truth, region, mu, grid)
        print(
            f"{name}: {seconds[name]:.1f} s of processor, {100 * found.rmse_near_rel:.2f} % near "
            f"bone, {100 * found.rmse_rel:.2f} % in the region",
            flush=True,
        )
    print(f"new / old: {seconds['new'] / seconds['old']:.2f} x")


if __name__ == "__main__":
    main()
