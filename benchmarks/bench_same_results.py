"""Compare two checkouts: results of all scenarios, schema, exit codes, and mutants of scenarios.

Each scenario of the older checkout is scaled down and run by both checkouts, over both links. Every
file of the scan store, the voxels of volume and truth, the stage digests, and the figures of
``metrics.json`` without seconds are compared bit by bit. Then both load mutants of the scenarios
(``tools/fuzz`` of the older checkout): a valid mutant has equal stage digests, an invalid one the
same exit code, lines and keys; words may differ.

    git worktree add /tmp/older HEAD~20; git worktree add /tmp/newer HEAD
    python benchmarks/bench_same_results.py /tmp/older /tmp/newer --mutants 2000
"""

from __future__ import annotations

import argparse
import ast
import concurrent.futures
import hashlib
import json
import os
import random
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

VIEWS, COLUMNS, VOXELS = 8, 40, 32
"""Scale of the runs: views, columns of the panel, and voxels along the longest axis of the grid."""

LINKS = ("local", "ros2")

FIGURED, SMALL = "circle_gantry.yaml", (
    "trajectory.views=6", "detector.columns=40", "detector.rows=30",
    "detector.pixel_pitch_mm=8", "reconstruction.grid={voxels: 24, voxel_mm: 6}",
)  # fmt: skip
"""The run whose figures are compared, and its changes."""

COMMANDS = (
    ("--help",), ("schema",), ("check", "none.yaml"), ("check", "demo", "--set", "detector.x=1"),
    ("run", "none.yaml", "--out", "out"), ("run", "demo", "--out", "out", "--set", "seed=a"),
    ("reconstruct", "none"), ("compare", "none", "none"), ("export", "none", "--to", "astra"),
    ("verify", "none"), ("study", "none.yaml", "--out", "out"), ("calibrate", "none"),
    ("geometry", "none"), ("view", "none"), ("plan", "none.yaml", "--out", "out"),
    ("place", "none.yaml"), ("reach", "none.yaml"), ("nothing",), ("run",),
)  # fmt: skip
"""Commands that end at once, for their exit codes."""


def inside(checkout: Path, *arguments: str, text: str = "") -> subprocess.CompletedProcess[str]:
    """Run Python with the package of a checkout."""
    paths = [checkout / "src", checkout / "tools" / "fuzz"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))}
    return subprocess.run(
        [sys.executable, *arguments],
        **{"capture_output": True, "text": True, "env": environment, "input": text},
    )


def of_package(checkout: Path, function: str, *arguments: str, text: str = "") -> Any:
    """Call a function of this file with the package of a checkout; it prints JSON."""
    done = inside(checkout, __file__, "--inside", function, *arguments, text=text)
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def scale(file: str) -> tuple[str, ...]:
    """Return the changes that scale a scenario down."""
    from twinct.scenario import load_scenario

    whole: Any = load_scenario(file)
    detector, section = whole.detector, whole.reconstruction
    shrink = detector.columns / COLUMNS
    changes: dict[str, Any] = {
        "detector.columns": COLUMNS,
        "detector.rows": round(detector.rows / shrink),
        "detector.pixel_pitch_mm": detector.pixel_pitch_mm * shrink,
        "reconstruction.grid.voxels": VOXELS,
        "reconstruction.grid.voxel_mm": section.grid.voxel_mm * section.grid.voxels / VOXELS,
        "trajectory.views": VIEWS,
        "reconstruction.iterations": 2,
    }
    if section.surroundings is not None:
        changes["reconstruction.surroundings.voxel_mm"] = 10.0
        changes["reconstruction.surroundings.iterations"] = 2
    return tuple(f"{key}={json.dumps(value)}" for key, value in changes.items())


def runs(folder: str, link: str, *files: str) -> None:
    """Run scenarios, and print digests of all that each wrote, by name; or what refused it."""
    results: dict[str, dict[str, str]] = {}
    for file in files:
        out = Path(folder) / Path(file).stem
        try:
            found = ran(file, link, out)
        except Exception as error:
            found = {"refused": f"{type(error).__name__}: {error}"}
            print(file, link, found, file=sys.stderr)
        results[Path(file).stem] = found | stored(out / "scan.zarr")
    print(json.dumps(results))


def ran(file: str, link: str, out: Path) -> dict[str, str]:
    """Run a scenario; over ROS 2 only its scan, as a volume is made of the store alone."""
    import twinct.runs.reporting
    from twinct.link import ros_rigs
    from twinct.runs import acquire_to_store
    from twinct.scan import SimulationBuilder
    from twinct.scenario import load_scenario, stage_digests

    scenario = load_scenario(file, scale(file))
    found = {f"digest of stage {stage}": one for stage, one in stage_digests(scenario).items()}
    if link == "local":
        twinct.runs.reporting.draw_pictures = lambda _: {}  # pages are compared for one run
        twinct.runs.reporting.write_report = lambda path, *_: path.touch()
        twinct.run(scenario, out, link="local")
        return found | volumes(out)
    out.mkdir(parents=True)
    rigs = ros_rigs(out / "logs")
    acquire_to_store(SimulationBuilder(scenario), out / "scan.zarr", rigs, resume=False)
    return found


def stored(store: Path) -> dict[str, str]:
    """Return the digest of each file of a scan store, and its attributes one by one.

    The manifest is left out: it holds digests of the other files.
    """
    found: dict[str, str] = {}
    for path in sorted(p for p in store.rglob("*") if p.is_file()):
        name = str(path.relative_to(store))
        if name == "zarr.json":
            facts = json.loads(path.read_text())
            facts["attributes"]["scenario"] = json.loads(facts["attributes"]["scenario"])
            found |= {f"{name}: {key}": repr(value) for key, value in flat(facts)}
        elif not name.startswith("manifest"):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def volumes(out: Path) -> dict[str, str]:
    """Return digests of voxels and affines; the header holds a note in words."""
    import nibabel.loadsave
    import numpy as np

    found: dict[str, str] = {}
    for path in sorted(out.glob("*.nii")):
        image: Any = nibabel.loadsave.load(path)
        data = np.asarray(image.dataobj).tobytes() + np.asarray(image.affine).tobytes()
        found[path.name] = hashlib.sha256(data).hexdigest()
    return found


def figures(out: Path) -> dict[str, str]:
    """Return the figures of a run, by dotted key, without those that depend on time and files."""
    from twinct.runs.folder import read_metrics

    metrics = read_metrics(out / "metrics.json")  # of today's names
    return {
        f"metrics.{key}": "" if re.match("seconds|real_time_factor|files", key) else repr(value)
        for key, value in flat(metrics)
    }


def flat(data: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield all values of nested mappings, by dotted key."""
    if isinstance(data, Mapping):
        for name, value in data.items():
            yield from flat(value, f"{key}.{name}" if key else name)
    else:
        yield key, data


def mutants(material: str, folder: str, number: str) -> None:
    """Write mutants of the scenarios, with overrides, by the fuzzing of the package at hand."""
    from scenario_files import Kind  # pyright: ignore[reportMissingImports]

    kind = Kind(Path(material))
    for seed in range(int(number)):
        place = Path(folder) / str(seed)
        place.mkdir()
        kind.case(random.Random(seed), place)
    print(json.dumps(number))


def loaded(folder: str, number: str) -> None:
    """Print the outcome of each mutant: digests, or exit code, lines and keys."""
    from twinct.scenario import load_scenario, stage_digests

    outcomes: list[Any] = []
    for seed in range(int(number)):
        place = Path(folder) / str(seed)
        told = place / "overrides.txt"
        overrides = (
            [ast.literal_eval(one) for one in told.read_text().split("\n")]
            if (told.exists())
            else []
        )
        try:
            outcomes.append(stage_digests(load_scenario(place / "mutant.yaml", tuple(overrides))))
        except Exception as error:
            kinds = [kind.__name__ for kind in type(error).__mro__]
            text = "\n".join(getattr(error, "problems", (str(error),)))
            code = 2 if "InputError" in kinds else 1
            outcomes.append({"code": code, "lines": places(text), "text": text})
    print(json.dumps(outcomes))


def places(text: str) -> list[str]:
    """Return what messages name as origin: the line, and the key after it."""
    found = re.findall(r"(?:line |yaml:)(\d+)[,:]?\d*:? ?([a-z_0-9.]*)", text)
    return sorted({f"{line} {key.strip('.')}" for line, key in found})


def without_words(schema: Any) -> Any:
    """Return a JSON Schema without descriptions and titles."""
    if isinstance(schema, dict):
        words = ("description", "title", "x-source", "examples")
        return {
            key: without_words(value)
            for key, value in schema.items()
            if not (key in words and isinstance(value, str))
        }
    return [without_words(one) for one in schema] if isinstance(schema, list) else schema


def schema(checkout: Path) -> Any:
    """Return the schema of scenarios, without words."""
    return without_words(json.loads(inside(checkout, "-m", "twinct", "schema").stdout))


def compared(title: str, older: Mapping[str, Any], newer: Mapping[str, Any]) -> bool:
    """Print how many entries are equal, and those that differ."""
    names = [*older, *(name for name in newer if name not in older)]
    other = [name for name in names if older.get(name) != newer.get(name)]
    print(f"{title}: {len(names) - len(other)} of {len(names)} equal", flush=True)
    for name in other[:12]:
        print(f"    {name}: {str(older.get(name))[:160]} -> {str(newer.get(name))[:160]}")
    return not other


def main() -> None:
    """Compare two checkouts, and print what differs."""
    if sys.argv[1:2] == ["--inside"]:
        globals()[sys.argv[2]](*sys.argv[3:])
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("older", type=lambda text: Path(text).absolute())
    parser.add_argument("newer", type=lambda text: Path(text).absolute())
    parser.add_argument("--mutants", type=int, default=2000, help="0: none")
    parser.add_argument("--only", nargs="*", help="names of scenarios; none: no runs")
    parser.add_argument("--links", nargs="*", default=LINKS)
    asked = parser.parse_args()
    both = (asked.older, asked.newer)
    files = sorted((asked.older / "scenarios").glob("*.yaml"))
    names = [str(file) for file in files if asked.only is None or file.stem in asked.only]
    with tempfile.TemporaryDirectory() as name, concurrent.futures.ThreadPoolExecutor(2) as pool:
        space = Path(name)
        for link in asked.links if names else ():
            outs = [space / f"{link}-{side}" for side in ("older", "newer")]
            calls = [(str(out), link, *names) for out in outs]
            made = [*pool.map(lambda one, call: of_package(one, "runs", *call), both, calls)]
            for file in made[0]:
                compared(f"{file}, {link}", *(of_side[file] for of_side in made))
        if names:
            run = ("-m", "twinct", "run", str(asked.older / "scenarios" / FIGURED))
            sets = [word for change in SMALL for word in ("--set", change)]
            measured = [
                inside(one, *run, "--out", f"{space}/{i}", *sets) for i, one in enumerate(both)
            ]
            if any(one.returncode for one in measured):
                raise SystemExit("\n".join(one.stderr for one in measured))
            compared("figures", *(figures(space / str(i)) for i in range(2)))
        compared("schema", *(dict(flat(schema(one))) for one in both))
        codes = [{" ".join(c): inside(one, "-m", "twinct", *c).returncode for c in COMMANDS}
                 for one in both]  # fmt: skip
        compared("exit codes", *codes)
        if asked.mutants:
            number = str(asked.mutants)
            (space / "material").mkdir()
            (space / "mutants").mkdir()
            of_package(asked.older, "mutants", f"{space}/material", f"{space}/mutants", number)
            outcomes = [of_package(one, "loaded", f"{space}/mutants", number) for one in both]
            told = [
                [{k: v for k, v in one.items() if k != "text"} for one in of] for of in outcomes
            ]
            compared("mutants", *({str(i): str(one) for i, one in enumerate(of)} for of in told))
            print(Counter("refused" if "code" in one else "valid" for one in outcomes[0]))


if __name__ == "__main__":
    main()
