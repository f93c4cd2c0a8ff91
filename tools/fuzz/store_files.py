"""Fuzzing of finished scans: damaged stores, with or without recomputed digests, in use."""

from __future__ import annotations

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr as _zarr
from cases import Case
from mutations import broken, nasty
from store_damages import KINDS, change, contents, drawn, seal_anew
from valid_scans import OLD, SCANS, make_scans

from twinct import load_scan, reconstruct, run
from twinct.core.errors import InputError
from twinct.runs import Folder, import_recordings, verify
from twinct.runs.job import finished_run
from twinct.runs.reconstruction_folder import stored_reconstructions
from twinct.runs.repair import resumable
from twinct.runs.stages import due, run_stages
from twinct.scan import Scan, ScanStore, image_digests
from twinct.scenario import load_scenario

zarr: Any = _zarr
"""Zarr, whose types are incomplete."""

NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e39, -1.0, 0.0, 2.0)
LARGE = (0, 1, -1, 2, 10**5, 2**31, 2**40, 2**62, 2**63, 10**30, 1.5, "1", None)
TYPES = (
    *("float64", "float32", "float16", "uint8", "int64", "bool", "complex128", "string", "bytes"),
    *("r800", "numpy.datetime64", "float128", "x"),
)
CODECS: tuple[Any, ...] = (
    *({"name": name} for name in ("crc32c", "gzip", "zstd", "bytes", "transpose", "vlen-utf8")),
    {"name": "bytes", "configuration": {"endian": "big"}},
    {"name": "gzip", "configuration": {"level": 99}},
    {"name": "blosc", "configuration": {"cname": "zlib", "clevel": 1, "shuffle": "noshuffle"}},
    {"name": "sharding_indexed", "configuration": {"chunk_shape": [1], "codecs": []}},
    {"name": "numcodecs.pickle"},
)

RUNS_AGAIN = 0.25
"""Share of the scans of the gantry that are run again to their end."""

Mend = Literal["not", "resume", "run"]
"""What a case does with a damaged scan: leave it, repair its frame, or run it to its end."""


class Kind:
    """A scan of each kind, damaged, then verified, read, reconstructed and resumed.

    Of a store with digests, ``verify`` names each change, only the original data are read, and a
    resume restores the original files.
    """

    seconds = 30.0
    memory_bytes = 2 * 2**30

    def __init__(self, material: Path) -> None:
        """Make the scans, unless an earlier worker has made them, and read them."""
        make_scans(material, "detector.keep=[raw]")
        self._material = material
        self._whole = {name: everything(load_scan(material / name)) for name in (*SCANS, *OLD)}

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case with one or two damages to a scan."""
        name = rng.choice(list(self._whole))
        shutil.copytree(self._material / name, folder / "run")
        scenario = self._material / name / "scenario.yaml"
        store, told = folder / "run" / "scan.zarr", [name]
        for _ in range(rng.choice((1, 1, 2))):
            kind = rng.choice(list(DAMAGES))
            told.append(kind)
            try:
                DAMAGES[kind](rng, store)
            except (OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError):
                told[-1] += " (could not be done)"  # because of the first damage
        sealed = name not in OLD and store.is_dir() and rng.random() < 0.5
        if sealed:
            told.append("digests anew")
            seal_anew(store)
        whole = None if sealed or name in OLD else self._material / name
        mend: Mend = "not"  # mending a scan of arms would plan its motion
        if name != "arms":
            mend = "run" if name == "gantry" and rng.random() < RUNS_AGAIN else "resume"
        return Case(", ".join(told), lambda: self._used(folder / "run", scenario, whole, mend))

    def _used(self, path: Path, scenario_file: Path, whole: Path | None, mend: Mend) -> str:
        """Verify, read, reconstruct and resume a scan as a user does; each step may be refused."""
        data = None if whole is None else self._whole[whole.name]
        files = None if whole is None else contents(whole / "scan.zarr")
        words = [
            _word(lambda: _verified(path, files)),
            _word(lambda: _read(path, data)),
            _word(lambda: _finished(path)),
            _word(lambda: _reconstructed(path)),
            _word(lambda: _imported(path)),
            _word(lambda: _resumed(path, scenario_file, mend=mend != "not")),
        ]
        if mend == "run":
            _word(lambda: _run_again(path, scenario_file, files))
        return "read" if words[1] != "refused" else "refused"


def _verified(path: Path, files: dict[str, Any] | None) -> None:
    now, said = contents(path / "scan.zarr"), verify(path)
    changed = {n for n, data in (files or {}).items() if data != "folder" and now.get(n) != data}
    if changed and not said.problems:
        raise AssertionError(f"not named: {', '.join(sorted(changed)[:3])}")


def _word(act: Callable[[], object]) -> str:
    try:
        act()
    except InputError as error:
        if not str(error).strip():
            raise AssertionError("refused without a reason") from None
        return "refused"
    return "done"


def everything(scan: Scan) -> bytes:
    """Return all data of a scan as bytes; raise AssertionError unless the numbers are finite."""
    found = [scan.transmission, scan.joints, scan.simulated_s]
    for which in ("commanded", "executed"):
        geometry = scan.poses(which).geometry(scan.scenario.detector.panel)
        found += [geometry.source, geometry.detector, geometry.u, geometry.v]
    believed = scan.believed  # may see the panel from behind if the joints are damaged
    found += [pose.matrix for pose in (*believed.source, *believed.detector)]
    found += [pose.matrix for pose in (*scan.simulated.executed_object, scan.stands)]
    found += [np.array([view.sevens for view in scan.simulated.exposure]).ravel()]
    for numbers in found:
        if not np.isfinite(numbers).all():
            raise AssertionError("a number that is not finite was accepted")
    if np.isinf(scan.clearance_mm).any():
        raise AssertionError("an infinite clearance was accepted")
    if len({len(scan), len(scan.executed), len(scan.joints), len(scan.simulated_s)}) != 1:
        raise AssertionError("arrays with different numbers of views")
    told = [numbers.tobytes() for numbers in (*found, scan.clearance_mm)]
    bad = b"" if scan.bad_pixels is None else scan.bad_pixels.tobytes()
    return b"".join([*told, bad, str(scan.simulated.joint_names).encode()])


def _read(path: Path, whole: bytes | None) -> None:
    found = everything(load_scan(path))
    store = ScanStore(path / "scan.zarr")
    for view in range(store.views):
        for name in store.stored_frames:
            if not np.isfinite(store.frame(name, view)).all():
                raise AssertionError("a grey value that is not finite was accepted")
    if whole is not None and found != whole:
        raise AssertionError("the data read differ from the data written")


def _finished(path: Path) -> None:
    finished = finished_run(Folder(path))
    _ = finished.figures, finished.volume, finished.scan.believed
    stored_reconstructions(finished.paths.reconstructions)


def _reconstructed(path: Path) -> None:
    if not np.isfinite(reconstruct(load_scan(path)).array).all():
        raise AssertionError("a volume that is not finite")


def _imported(path: Path) -> None:
    if (path / "scan.mcap").exists():  # runs of version 0.1 have none
        import_recordings([path / "scan.mcap"], path.parent / "imported")
        everything(load_scan(path.parent / "imported"))


def _resumed(path: Path, scenario_file: Path, *, mend: bool) -> None:
    folder, scenario = Folder(path), load_scenario(scenario_file)
    folder.refuse_others()
    store = resumable(folder, scenario) if mend else ScanStore(folder.scan)
    store.refuse_other(image_digests(scenario))
    due(run_stages(folder, scenario))
    store = ScanStore.resume(folder.scan, image_digests(scenario))
    _ = store.plan
    for views in store.missing:
        if views.start and not np.isfinite(store.state(views.start - 1)).all():
            raise AssertionError("a state that is not finite was accepted")


def _run_again(path: Path, scenario_file: Path, files: dict[str, Any] | None) -> None:
    """Run with ``--resume``: the store is whole again, or refused and unchanged."""
    store = path / "scan.zarr"
    before = contents(store)
    try:
        run(load_scenario(scenario_file), path, link="local", resume=True)
    except InputError:
        if contents(store) != before:
            raise AssertionError("refused, but changed") from None
        raise
    now = contents(store)
    if lost := [name for name, data in (files or {}).items() if now.get(name) != data]:
        raise AssertionError(f"resumed, but differs in {', '.join(lost[:3])}")
    if lost := [name for name in before.keys() - (files or before).keys() if name not in now]:
        raise AssertionError(f"resumed, but lost {', '.join(lost[:3])}")


def _values(rng: random.Random, path: Path) -> None:
    """Change one number of an array, or all numbers at one index of its first axis."""
    names = [p.parent for p in sorted(path.rglob("zarr.json")) if "manifest" not in p.parts]
    arrays = [p for p in names if json.loads((p / "zarr.json").read_text())["node_type"] == "array"]
    array = zarr.open_array(str(rng.choice(arrays)), mode="r+")
    view, number = rng.randrange(array.shape[0]), rng.choice(NUMBERS)
    with np.errstate(all="ignore"):
        values = np.array(array[view])
        if rng.random() < 0.3:
            values[...] = np.asarray(number).astype(array.dtype)
        else:
            values.flat[rng.randrange(values.size)] = np.asarray(number).astype(array.dtype)
        array[view] = values


def _header(rng: random.Random, path: Path) -> None:
    """Change shape, type, chunks, codecs or other metadata of arrays and groups."""
    every = [p for p in sorted(path.rglob("zarr.json")) if rng.random() < 0.9] or [path]
    for file in rng.choice(([rng.choice(every)], [rng.choice(every)], every)):
        told = json.loads(file.read_text())
        match rng.choice(
            ("shape", "shape", "data_type", "chunks", "codecs", "fill_value", "other")
        ):
            case "shape" if told.get("shape"):
                told["shape"][rng.randrange(len(told["shape"]))] = rng.choice(LARGE)
            case "shape":
                told["shape"] = [rng.choice(LARGE) for _ in range(rng.randrange(5))]
            case "data_type":
                told["data_type"] = rng.choice(TYPES)
            case "chunks" if told.get("chunk_grid"):
                chunks = told["chunk_grid"]["configuration"]["chunk_shape"]
                chunks[rng.randrange(len(chunks))] = rng.choice(LARGE)
            case "codecs" if told.get("codecs"):
                told["codecs"].insert(rng.randrange(len(told["codecs"]) + 1), rng.choice(CODECS))
                if rng.random() < 0.5:
                    del told["codecs"][rng.randrange(len(told["codecs"]))]
            case "fill_value":
                told["fill_value"] = nasty(rng)
            case _:
                told[rng.choice(sorted(told))] = nasty(rng)
        file.write_text(json.dumps(told))


def _scenario(rng: random.Random, path: Path) -> None:
    """Change a value of the scenario in the store."""
    told = json.loads((path / "zarr.json").read_text())
    inner = json.loads(told["attributes"]["scenario"])
    section = rng.choice([inner, *(v for v in inner.values() if isinstance(v, dict) and v)])
    if rng.random() < 0.5:
        section[rng.choice(sorted(section))] = nasty(rng)
    else:
        change(rng, section)
    told["attributes"]["scenario"] = json.dumps(inner)
    (path / "zarr.json").write_text(json.dumps(told))


def _attributes(rng: random.Random, path: Path) -> None:
    """Change an attribute of the store or of its plan."""
    file = rng.choice([f for f in (path / "zarr.json", path / "plan" / "zarr.json") if f.exists()])
    told = json.loads(file.read_text())
    told["attributes"][rng.choice(sorted(told["attributes"]))] = nasty(rng)
    file.write_text(json.dumps(told))


def _giant(rng: random.Random, path: Path) -> None:
    """Write very long or very deeply nested metadata."""
    file = drawn(rng, path, "zarr.json")
    depth = rng.choice((1000, 100_000))
    text = file.read_text()
    new = rng.choice(
        ("[" * depth, '{"a":' * depth, "[" * depth + "]" * depth, " " * 10**7, "1" * 10**5)
    )
    at = rng.choice((0, len(text), text.index("{") + 1))
    file.write_text(f"{text[:at]}{new}{text[at:]}" if rng.random() < 0.5 else new)


def _beside(rng: random.Random, path: Path) -> None:
    """Damage a file beside the store, or replace it with a pipe, folder, link or nothing."""
    there = [p for p in sorted(path.parent.rglob("*")) if p.is_file() and path not in p.parents]
    file = rng.choice(there)
    if rng.random() < 0.7:
        file.write_bytes(broken(rng, file.read_bytes())[0])
        return
    file.unlink()
    match rng.choice(("pipe", "folder", "dangling", "nothing", "device")):
        case "pipe":
            os.mkfifo(file)
        case "folder":
            file.mkdir()
        case "dangling":
            file.symlink_to(file)
        case "device":
            file.symlink_to("/dev/zero")
        case _:
            pass


DAMAGES: dict[str, Callable[[random.Random, Path], None]] = {
    **{name: damage for name, damage in KINDS.items() if name != "resealed"},
    **{"values": _values, "values too": _values, "header": _header, "header too": _header},
    **{"scenario": _scenario, "attributes": _attributes, "giant": _giant, "beside": _beside},
}
