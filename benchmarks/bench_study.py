"""What a study costs beyond its trials, what it gains, and what it says beforehand.

python benchmarks/bench_study.py overhead    200 trials of 8 views, 32^3, against the same calls
python benchmarks/bench_study.py scaling     40 scans of demo size, 2 workers against 1
python benchmarks/bench_study.py sharing     10 relaxations on one scan against its parts
python benchmarks/bench_study.py plans       5 seeds of the arms' errors, one plan against five
python benchmarks/bench_study.py estimates   12 trials against what one trial said of them

Workers are warm, and each has one thread. What is compared takes turns, so that a noisy machine
slows both. ``--pool ray`` takes Ray's workers in place of local processes (not for estimates).
"""

import argparse
import os
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from statistics import median

os.environ["TWINCT_THREADS"] = "1"

from twinct.core.cached import forget  # noqa: E402
from twinct.core.threads import limit_threads  # noqa: E402
from twinct.study import dry_run, load_results, load_study, run_study  # noqa: E402
from twinct.study.checking import Checker  # noqa: E402
from twinct.study.driver import Driver  # noqa: E402
from twinct.study.estimate import bytes_below  # noqa: E402
from twinct.study.folder import StudyFolder  # noqa: E402
from twinct.study.rows import Rows  # noqa: E402
from twinct.study.trial import take_scan, try_trial  # noqa: E402
from twinct.workers import (  # noqa: E402 - threads are bounded before anything is loaded
    LocalPool,
    Place,
)

ROOT = Path(__file__).parents[1]
SMALL = {
    "trajectory.views": 8,
    "reconstruction.grid": {"voxels": 32, "voxel_mm": 4.96},
}


def seeds(number, scenario, **keys):
    """A study of scans that differ in nothing but their noise."""
    values = list(range(number))
    return {
        "scenario": str(ROOT / "scenarios" / scenario),
        "set": {"detector.noise": {"kind": "snr", "snr": 100.0}, **keys},
        "axes": [{"key": "seed", "label": "noise", "values": values}],
    }


class Bench:
    """One study with a folder and checked trials."""

    def __init__(self, told, folder):
        self.design, self.folder = load_study(told), StudyFolder(folder)
        folder.mkdir(parents=True)
        self.rows = Rows(self.folder, self.design.study)
        self.trials = Checker(self.design).checked(self.design.trials())

    def on(self, pool):
        """A driver of this study on a pool."""
        return Driver(self.design, self.folder, self.rows, pool, lambda _: None, len(self.trials))


def here_at(folder):
    """Return a place of work in this process, to which nothing is offered."""
    folder.mkdir(parents=True, exist_ok=True)
    return Place(folder, 1, {}.__getitem__)


@contextmanager
def pool_of(kind, workers, folder):
    """Warm workers of one thread each."""
    if kind == "local":
        pool = LocalPool(folder, workers=workers, threads=1)
    else:
        from twinct.workers.cluster import RayPool

        pool = RayPool("local", name=f"bench-{workers}", threads=1)
    with pool:
        yield pool


def seconds_of(call, *arguments):
    """Wall-clock seconds of a call."""
    start = time.perf_counter()
    call(*arguments)
    return time.perf_counter() - start


def call_all(specs, place):
    """The bare calls of some trials."""
    for spec in specs:
        try_trial(spec, place)


def overhead(kind, folder, number):
    """Seconds that a study takes for each trial beyond the bare call."""
    bench = Bench(seeds(number + 2, "circle_gantry.yaml", **SMALL), folder / "study")
    here = here_at(folder / "here")
    blocks = [bench.trials[2:][i : i + 10] for i in range(0, number, 10)]
    differences = []
    with pool_of(kind, 1, folder / "work") as pool:
        driver = bench.on(pool)
        driver.run(bench.trials[:2])
        specs = [driver.spec(one, shared=False) for one in bench.trials]
        for spec in specs[:2]:
            try_trial(spec, here)
        by_key = {spec.key: spec for spec in specs}
        for turn, block in enumerate(blocks):
            tried = seconds_of(driver.run, block)
            called = seconds_of(call_all, [by_key[one.key] for one in block], here)
            differences.append((tried - called) / len(block))
            each, bare = tried / len(block), called / len(block)
            print(f"block {turn}: {each:.3f} s a trial, bare {bare:.3f} s")
    mean = sum(differences) / len(differences)
    print(f"{kind}: {number} trials: {mean:+.4f} s each (median {median(differences):+.4f} s)")


def scaling(kind, folder, number):
    """How much faster two workers take scans than one."""
    told = seeds(number + 4, "demo.yaml", **{"reconstruction.iterations": 1})
    benches = {workers: Bench(told, folder / f"study{workers}") for workers in (1, 2)}
    trials = benches[1].trials
    turns = [trials[4:][i : i + 4] for i in range(0, number, 4)]
    spent = {1: 0.0, 2: 0.0}
    with pool_of(kind, 1, folder / "one") as one, pool_of(kind, 2, folder / "two") as two:
        drivers = {1: benches[1].on(one), 2: benches[2].on(two)}
        drivers[1].run(trials[:1])
        drivers[2].run(trials[:4])
        for turn, block in enumerate(turns):
            for workers in (1, 2) if turn % 2 else (2, 1):
                seconds = seconds_of(drivers[workers].run, block)
                spent[workers] += seconds
                told = f"{workers} workers, {seconds:.1f} s for {len(block)} scans"
                print(f"turn {turn}: {told}", flush=True)
    print(f"{kind}: {number} scans: {spent[1] / spent[2]:.2f} x as fast with two workers")


SCAN = "specimen", "plan", "scan"
"""Stages that a scan is made of."""


def sharing(kind, folder, number):
    """A study of relaxations on one scan, against the scan and the reconstructions alone.

    Against its own, as its rows have them, a noisy machine does not count; against the same calls
    afterwards it does.
    """
    values = [0.1 * (1 + i) for i in range(number)]
    told = {
        "scenario": str(ROOT / "scenarios" / "demo.yaml"),
        "axes": [{"key": "reconstruction.relaxation", "values": values}],
    }
    ratios = []
    for turn in range(2):
        bench, here = Bench(told, folder / f"study{turn}"), here_at(folder / f"here{turn}")
        with pool_of(kind, 1, folder / f"work{turn}") as pool:
            warm = Bench(seeds(1, "circle_gantry.yaml", **SMALL), folder / f"warm{turn}")
            warm.on(pool).run(warm.trials)
            driver = bench.on(pool)
            specs = [driver.spec(one, shared=True) for one in bench.trials]
            studied = seconds_of(driver.run, bench.trials)
        rows = load_results(bench.folder.path)
        own = sum(rows[f"seconds.{stage}"].sum() for stage in (*SCAN, "reconstruction"))
        alone = seconds_of(take_scan, specs[0], here)
        parts = [try_trial(spec, here)["seconds"]["reconstruction"] for spec in specs]
        ratios.append((studied / own, studied / (alone + sum(parts))))
        each = median(parts)
        print(
            f"turn {turn}: study {studied:.1f} s, of these its scan and reconstructions "
            f"{own:.1f} s; alone: scan {alone:.1f} s, {number} x {each:.1f} s",
            flush=True,
        )
    for name, found in zip(
        ("its own parts", "the same work alone"), zip(*ratios, strict=True), strict=True
    ):
        print(f"{kind}: {' and '.join(f'{ratio:.3f}' for ratio in found)} x {name}")


def plans(kind, folder, number):
    """Trials that differ in the seed of the arms' errors: one plan for all against one each."""
    told = seeds(number, "demo.yaml", **{"uncertainty.arms.tool_mm": 0.2})
    bench = Bench(told, folder / "study")
    driver = bench.on(None)
    specs = [driver.spec(one, shared=False) for one in bench.trials]
    try_trial(specs[0], here_at(folder / "warm"))
    spent, planned = {"shared": 0.0, "own": 0.0}, {"shared": 0.0, "own": 0.0}
    for turn, spec in enumerate(specs):
        places = {"shared": folder / "shared", "own": folder / f"own{turn}"}
        for which in ("shared", "own") if turn % 2 else ("own", "shared"):
            for made in ("plan", "scan", "truth"):
                forget(made)  # as another worker would find it
            began = time.perf_counter()
            stages = try_trial(spec, here_at(places[which]))["seconds"]
            spent[which] += time.perf_counter() - began
            planned[which] += stages["plan"]
        print(f"trial {turn}: one plan {spent['shared']:.1f} s, own {spent['own']:.1f} s so far")
    for which in spent:
        print(f"{which}: {spent[which]:.1f} s, of these {planned[which]:.1f} s for plans")
    print(f"{number} trials: {spent['own'] / spent['shared']:.2f} x as fast with one plan")


def estimates(kind, folder, number):
    """What was estimated of a study after one trial of its kind, against what it took."""
    os.environ["XDG_CACHE_HOME"] = str(folder / "cache")

    def told(keep, scans, relaxations):
        study = seeds(scans, "circle_gantry.yaml", **{"reconstruction.grid.voxels": 128})
        axis = {"key": "reconstruction.relaxation", "values": relaxations}
        return {**study, "axes": [*study["axes"], axis], "keep": keep}

    for keep in ("figures", "volume", "everything"):
        run_study(told(keep, 1, [0.3]), folder / "one" / keep, jobs=1)
        study = told(keep, number // 4, [0.2, 0.3, 0.4, 0.5])
        said = dry_run(study, jobs=1).estimate
        seconds = seconds_of(lambda study: run_study(study, folder / study["keep"], jobs=1), study)
        size = bytes_below([folder / keep])
        assert said.seconds is not None, "one trial of the kind was run"
        print(
            f"{keep}: {size / 1e6:.1f} MB, {said.disk_bytes / size:.3f} x estimated; "
            f"{seconds:.0f} s, {said.seconds / seconds:.2f} x estimated"
        )


def main():
    """Run one of the five."""
    parser = argparse.ArgumentParser(description=__doc__)
    what = {"overhead": (overhead, 200), "scaling": (scaling, 40), "sharing": (sharing, 10)}
    what |= {"plans": (plans, 5), "estimates": (estimates, 12)}
    parser.add_argument("what", choices=what, nargs="?", default="overhead")
    parser.add_argument("--pool", choices=("local", "ray"), default="local")
    parser.add_argument("--number", type=int)
    options = parser.parse_args()
    limit_threads(1)
    function, usual = what[options.what]
    with tempfile.TemporaryDirectory() as name:
        function(options.pool, Path(name), options.number or usual)


if __name__ == "__main__":
    main()
