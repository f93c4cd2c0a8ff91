"""Damage a finished scan in hundreds of ways; each must be named, and mended or refused.

python tools/damage_store.py --damages 500 --seed 1
python tools/damage_store.py --kinds resealed --seed 2 --unvouched

Bits, bytes, cut and grown files, files and folders that are missing, exchanged, copied over others
or of another kind (a folder, a link, a pipe), metadata with other values, files that are added; and
``resealed``: metadata with other values whose digests were made anew, which only a look at the
values can find. After each

- ``twinct verify`` names the file, if a file of the store has other bytes or is gone, and lists
  what was added;
- reading the scan gives what was there, or ends with a message;
- ``twinct run --resume`` gives the undisturbed store, what was added left alone, or ends with a
  message and exit code 2, nothing changed.

With ``--unvouched`` the store is one of version 0.1, which has no digests: then no more is asked
than a message. Anything else than a message is printed with the damage's number, and ends this with
1; ``--only`` does one again. One damage in five is to a scan of arms, which follow a plan that the
store keeps, the others to one of a gantry.
"""

import argparse
import contextlib
import hashlib
import json
import logging
import os
import random
import shutil
import sys
import tarfile
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from pathlib import Path

from twinct import run
from twinct.errors import InputError
from twinct.runs import verify
from twinct.scan import ScanStore
from twinct.scan.manifest import FRAME_FILE, sealed, unsealed
from twinct.scenario import load_scenario

ROOT = Path(__file__).parents[1]
KEYS = [
    "trajectory.views=6",
    "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 50}}]",
    "reconstruction.grid={voxels: 20, voxel_mm: 8}",
    "reconstruction.iterations=2",
]
SCENARIOS = {"gantry": "circle_gantry.yaml", "arms": "demo.yaml"}
VALUES = [None, 0, 1, -1, 99, 10**12, 0.5, 1e308, "", "x", "NaN", [], [1], {}, True, "f8", "10"]
STRANGERS = [".DS_Store", "notes.txt", "zarr.json~", ".zarr.json.swp", "c.10.0.0", "c", "deep/er/x"]


def contents(path):
    """Everything below a folder: bytes of files, and of what else there is its kind."""
    return {str(p.relative_to(path)): what(p) for p in sorted(path.rglob("*"))}


def what(path):
    """Bytes of a file, or of the one that it leads to; the name of any other kind."""
    if path.is_file():
        return path.read_bytes()
    if path.is_symlink():
        return f"link to {os.readlink(path)}"
    return "folder" if path.is_dir() else "special"


def files(path):
    """Names of a store's files. Half of all damage goes to the few that are of no view."""
    return [str(p.relative_to(path)) for p in sorted(path.rglob("*")) if p.is_file()]


def drawn(rng, path, of=""):
    """A file of the store."""
    names = [name for name in files(path) if of in name and (path / name).stat().st_size]
    few = [name for name in names if "/c." not in name]
    return path / rng.choice(few if few and rng.random() < 0.5 else names)


def bit(rng, path):
    """One bit of a file."""
    file = drawn(rng, path)
    data = bytearray(file.read_bytes())
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    file.write_bytes(data)


def bytes_(rng, path):
    """Some bytes of a file, next to each other."""
    file = drawn(rng, path)
    data = bytearray(file.read_bytes())
    first = rng.randrange(len(data))
    last = min(len(data), first + rng.choice([1, 8, 64, 4096]))
    data[first:last] = rng.randbytes(last - first)
    file.write_bytes(data)


def cut(rng, path):
    """The end of a file lost, or all of it."""
    file = drawn(rng, path)
    file.write_bytes(file.read_bytes()[: rng.choice([0, rng.randrange(file.stat().st_size)])])


def grown(rng, path):
    """Bytes behind a file's end."""
    file = drawn(rng, path)
    file.write_bytes(file.read_bytes() + rng.choice([b"\0", b" ", b"\n", rng.randbytes(50)]))


def missing(rng, path):
    """A file that is gone."""
    drawn(rng, path).unlink()


def folder_missing(rng, path):
    """A folder that is gone, with all in it."""
    shutil.rmtree(rng.choice([p for p in sorted(path.rglob("*")) if p.is_dir()]))


def exchanged(rng, path):
    """Two files that have each other's place, those of one array more often."""
    one = drawn(rng, path)
    alike = [p for p in one.parent.iterdir() if p.is_file() and p != one]
    other = rng.choice(alike) if alike and rng.random() < 0.7 else drawn(rng, path)
    a, b = one.read_bytes(), other.read_bytes()
    one.write_bytes(b)
    other.write_bytes(a)


def copied(rng, path):
    """A file over another."""
    one, other = drawn(rng, path), drawn(rng, path)
    other.write_bytes(one.read_bytes())


def other_kind(rng, path):
    """A folder, a link, a pipe or nothing readable in a file's place; a file in a folder's."""
    file = drawn(rng, path)
    kind = rng.choice(["folder", "link", "dangling", "loop", "pipe", "file"])
    if kind == "file":
        folder = rng.choice([p for p in sorted(path.rglob("*")) if p.is_dir()])
        shutil.rmtree(folder)
        folder.write_bytes(b"no folder")
        return
    file.unlink()
    if kind == "folder":
        file.mkdir()
    elif kind == "pipe":
        os.mkfifo(file)
    else:
        targets = {"link": drawn(rng, path), "dangling": path / "nothing", "loop": file}
        file.symlink_to(targets[kind])


def metadata(rng, path):
    """One value in the metadata of the store or an array."""
    file = rng.choice([path / "zarr.json", drawn(rng, path, "zarr.json")])
    told = json.loads(file.read_text())
    if file.parent == path and rng.random() < 0.3:  # within the scenario
        inner = json.loads(told["attributes"]["scenario"])
        change(rng, inner)
        told["attributes"]["scenario"] = json.dumps(inner)
    else:
        change(rng, told)
    file.write_text(json.dumps(told, indent=2))


def change(rng, told):
    """Another value in nested mappings and lists: changed, left out or added."""
    place, key = told, rng.choice(sorted(told))
    while isinstance(place[key], dict | list) and place[key] and rng.random() < 0.8:
        place = place[key]
        key = rng.choice(sorted(place)) if isinstance(place, dict) else rng.randrange(len(place))
    kind = rng.random()
    if kind < 0.25:
        del place[key]
    elif kind < 0.35 and isinstance(place, dict):
        place["surplus"] = rng.choice(VALUES)
    else:
        place[key] = rng.choice(VALUES)


def resealed(rng, path):
    """Metadata with another value, and a manifest that knows no better."""
    metadata(rng, path)
    if not (path / FRAME_FILE).exists():
        return
    known = unsealed((path / FRAME_FILE).read_bytes())
    now = {name: hashlib.sha256((path / name).read_bytes()).hexdigest() for name in known}
    (path / FRAME_FILE).write_bytes(sealed(now))


def added(rng, path):
    """A file, a folder or something else that is none of the store's."""
    folders = [path, *(p for p in sorted(path.rglob("*")) if p.is_dir())]
    file = rng.choice(folders) / rng.choice(STRANGERS)
    if file.exists():
        file = file.with_name("c.77")
    file.parent.mkdir(parents=True, exist_ok=True)
    kind = rng.choice(["file", "file", "empty", "folder", "link", "pipe"])
    if kind == "folder":
        file.mkdir()
    elif kind == "link":
        file.symlink_to("/etc/hostname")
    elif kind == "pipe":
        os.mkfifo(file)
    else:
        file.write_bytes(b"" if kind == "empty" else rng.randbytes(100))


KINDS = {
    **{"bit": bit, "bytes": bytes_, "cut": cut, "grown": grown, "missing": missing},
    **{"folder": folder_missing, "exchanged": exchanged, "copied": copied},
    **{"other kind": other_kind, "metadata": metadata, "resealed": resealed, "added": added},
}


def restore(path, kept):
    """Put everything back as it was, with no trust in what is there."""
    for link in [p for p in path.rglob("*") if p.is_symlink()]:
        link.unlink()
    now = contents(path) if path.is_dir() and not path.is_symlink() else {}
    if not now:
        with contextlib.suppress(OSError):
            path.unlink()
        path.mkdir(exist_ok=True)
    for name in sorted(now, reverse=True):
        if kept.get(name) != now[name]:
            there = path / name
            shutil.rmtree(there) if now[name] == "folder" else there.unlink(missing_ok=True)
    for name, data in kept.items():
        there = path / name
        if data == "folder":
            there.mkdir(exist_ok=True)
        elif not there.exists():
            there.write_bytes(data)


class Trials:
    """A finished run that is damaged again and again."""

    def __init__(self, folder, scenario, *, vouched=True):
        """Make the run, or unpack one of version 0.1."""
        self.folder, self.vouched, self.path = folder, vouched, folder / "scan.zarr"
        if vouched:
            self.scenario = load_scenario(ROOT / "scenarios" / scenario, KEYS)
            run(self.scenario, folder, link="local")
        else:
            with tarfile.open(ROOT / "tests" / "version_0_1" / "local.tar.xz") as archive:
                archive.extractall(folder, filter="data")
            file = folder / "scenario.yaml"
            self.scenario = load_scenario(file, ["motion.scheme=reactive"])
        self.kept = contents(self.path)
        self.beside = {p.name for p in folder.iterdir()}
        self.read = self.digest()

    def digest(self):
        """Of everything that a scan is asked for."""
        scan = ScanStore(self.path).read()
        told = hashlib.sha256(scan.transmission.tobytes() + scan.joints.tobytes())
        for pairs in (scan.commanded, scan.executed, scan.believed):
            told.update(pairs.geometry(scan.scenario.detector.panel).source.tobytes())
            told.update(pairs.geometry(scan.scenario.detector.panel).u.tobytes())
        told.update(scan.simulated_s.tobytes() + scan.clearance_mm.tobytes())
        return told.hexdigest() + scan.scenario.resolved() + str(scan.joint_names)

    def trial(self, kind, seed):
        """What came of one damage: faults, and in a word each what verify and resume did."""
        rng = random.Random(seed)
        faults, words, told = [], {}, ""
        KINDS[kind](rng, self.path)
        hit = contents(self.path)
        changed = {n for n in self.kept if hit.get(n) != self.kept[n] and self.kept[n] != "folder"}
        surplus = {n for n in hit.keys() - self.kept.keys() if hit[n] != "folder"}
        if kind == "resealed":
            changed = set()  # but to the eye
        started = time.monotonic()
        said = self.said(faults, "verify", lambda: verify(self.folder))
        if isinstance(said, InputError):
            words["verify"], told = "refused", str(said)
        elif said is not None:
            told = "\n".join(said.problems)
            words["verify"] = "named" if said.problems else "whole"
            listed = {str(p.relative_to(self.path)) for p in said.unknown}
            if self.vouched and said.unknown is not None and not said.problems:
                faults += [f"{name} is not listed" for name in surplus - listed]
        if self.vouched and changed and words.get("verify") == "whole":
            faults.append(f"not named: {', '.join(sorted(changed)[:3])}")
        if self.vouched and words.get("verify") == "named" and len(changed) == 1:
            (name,) = changed
            array, _, last = name.rpartition("/")
            view = last.split(".")[1] if last.startswith("c.") else None
            if name not in told and f"view {view}, {array}" not in told:
                faults.append(f"{name} is not named in {told!r}")
        read = self.said(faults, "read", self.digest)
        if isinstance(read, str) and read != self.read and self.vouched and kind != "resealed":
            faults.append("other data was read")
        words["read"] = "whole" if read == self.read else "other" if isinstance(read, str) else "no"
        again = self.said(
            faults, "resume", lambda: run(self.scenario, self.folder, link="local", resume=True)
        )
        after = contents(self.path) if self.path.is_dir() else {}
        if isinstance(again, InputError):
            words["resume"] = "refused"
            if after != hit:
                faults.append(f"refused, and changed {differ(after, hit)}")
        elif again is not None:
            wanted = self.kept | {name: hit[name] for name in hit.keys() - self.kept.keys()}
            words["resume"] = "whole" if hit == wanted else "mended"
            if self.vouched and kind != "resealed" and after != wanted:
                faults.append(f"resumed, and differs in {differ(after, wanted)}")
        if left := {p.name for p in self.folder.iterdir()} - self.beside:
            faults += [f"left {name}" for name in sorted(left - {"twinct.log", "seconds.json"})]
        self.put_back()
        return faults, words, time.monotonic() - started

    def said(self, faults, of, act):
        """What came of it, or the message that it ended with; anything else is a fault."""
        try:
            return act()
        except InputError as error:
            return error
        except Exception:
            faults.append(f"{of}: {traceback.format_exc()}")
            return None

    def put_back(self):
        """As it was before, store and what is beside it."""
        restore(self.path, self.kept)
        for there in self.folder.iterdir():
            if there.name not in self.beside:
                shutil.rmtree(there) if there.is_dir() else there.unlink()


def differ(one, other):
    """Names of what differs."""
    names = [n for n in sorted(one.keys() | other.keys()) if one.get(n) != other.get(n)]
    return ", ".join(names[:4])


def main():
    """Run the trials and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--damages", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--unvouched", action="store_true", help="a store of version 0.1")
    parser.add_argument("--only", type=int, help="number of the one damage to do")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    table, bad, slowest = defaultdict(Counter), 0, 0.0
    with tempfile.TemporaryDirectory() as name:
        names = ["arms"] if options.unvouched else ["gantry", "arms"]
        made = [
            Trials(Path(name) / of, SCENARIOS[of], vouched=not options.unvouched) for of in names
        ]
        numbers = range(options.damages) if options.only is None else [options.only]
        for number in numbers:
            kind = options.kinds[number % len(options.kinds)]
            trials = made[-1 if number % 5 == 4 else 0]
            faults, words, seconds = trials.trial(kind, f"{options.seed} {number}")
            table[kind].update(f"{of} {word}" for of, word in words.items())
            table[kind]["damages"] += 1
            table[kind]["faults"] += bool(faults)
            slowest, bad = max(slowest, seconds), bad + bool(faults)
            for fault in faults:
                print(f"{kind}, number {number}: {fault}", file=sys.stderr, flush=True)
    heads = ["damages", "verify named", "verify refused", "verify whole", "read no", "read whole"]
    heads += ["read other", "resume mended", "resume refused", "resume whole", "faults"]
    print("kind       | " + " | ".join(heads))
    for kind, counts in table.items():
        print(f"{kind:10} | " + " | ".join(f"{counts[h]:{len(h)}}" for h in heads))
    print(f"slowest {slowest:.1f} s")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
