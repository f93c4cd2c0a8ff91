"""Damage a finished scan in hundreds of ways; each must be named, and repaired or refused.

python tools/damage_store.py --damages 500 --seed 1
python tools/damage_store.py --kinds resealed --seed 2 --unvouched

Damages: changed bits and bytes; truncated and extended files; files and folders that are missing,
exchanged, copied over others or replaced with another kind (folder, link, pipe); changed values in
metadata; added files; and ``resealed``: changed metadata with recomputed digests, which only a
check of the values can detect. After each damage

- ``twinct verify`` names each file of the store that is changed or missing, and lists added files;
- reading the scan gives the original data or ends with a message;
- ``twinct run --resume`` restores the undisturbed store and leaves added files alone, or ends with
  a message and exit code 2 and changes nothing.

With ``--unvouched`` the store is of version 0.1, which has no digests; then only messages are
required. Every fault is printed with the number of its damage, and the exit code is 1; ``--only``
repeats one damage. One damage in five is to a scan of arms with a plan in its store, the others are
to a scan of a gantry.
"""

import argparse
import hashlib
import logging
import random
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from pathlib import Path

from store_damages import KINDS, contents, differ, restore

from twinct import run
from twinct.core.errors import InputError
from twinct.runs import verify
from twinct.scan import ScanStore
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


class Trials:
    """A finished run that is damaged repeatedly."""

    def __init__(self, folder, scenario, *, vouched=True):
        """Make the run, or unpack a run of version 0.1."""
        self.folder, self.vouched, self.path = folder, vouched, folder / "scan.zarr"
        if vouched:
            self.scenario = load_scenario(ROOT / "scenarios" / scenario, KEYS)
            run(self.scenario, folder, link="local")
        else:
            shutil.unpack_archive(ROOT / "tests" / "version_0_1" / "local.tar.xz", folder)
            file = folder / "scenario.yaml"
            self.scenario = load_scenario(file, ["motion.scheme=reactive"])
            run(self.scenario, folder, link="local", resume=True)  # adds the report
        self.kept = contents(self.path)
        self.beside = {p.name for p in folder.iterdir()}
        self.read = self.digest()

    def digest(self):
        """Return a digest of all data of the scan."""
        scan = ScanStore(self.path).read()
        told = hashlib.sha256(scan.transmission.tobytes() + scan.joints.tobytes())
        for pairs in (scan.commanded, scan.executed, scan.believed):
            told.update(pairs.geometry(scan.scenario.detector.panel).source.tobytes())
            told.update(pairs.geometry(scan.scenario.detector.panel).u.tobytes())
        told.update(scan.simulated_s.tobytes() + scan.clearance_mm.tobytes())
        return told.hexdigest() + scan.scenario.resolved() + str(scan.simulated.joint_names)

    def trial(self, kind, seed):
        """Do one damage; return faults, outcomes of verify, read and resume, and seconds."""
        rng = random.Random(seed)
        faults, words, told = [], {}, ""
        KINDS[kind](rng, self.path)
        hit = contents(self.path)
        changed = {n for n in self.kept if hit.get(n) != self.kept[n] and self.kept[n] != "folder"}
        surplus = {n for n in hit.keys() - self.kept.keys() if hit[n] != "folder"}
        if kind == "resealed":
            changed = set()  # the digests match
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
            faults.append("different data was read")
        words["read"] = "whole" if read == self.read else "other" if isinstance(read, str) else "no"
        again = self.said(
            faults, "resume", lambda: run(self.scenario, self.folder, link="local", resume=True)
        )
        after = contents(self.path) if self.path.is_dir() else {}
        if isinstance(again, InputError):
            words["resume"] = "refused"
            if after != hit:
                faults.append(f"refused, but changed {differ(after, hit)}")
        elif again is not None:
            wanted = self.kept | {name: hit[name] for name in hit.keys() - self.kept.keys()}
            words["resume"] = "whole" if hit == wanted else "mended"
            if self.vouched and kind != "resealed" and after != wanted:
                faults.append(f"resumed, but differs in {differ(after, wanted)}")
        if left := {p.name for p in self.folder.iterdir()} - self.beside:
            faults += [f"left {name}" for name in sorted(left - {"twinct.log", "seconds.json"})]
        self.put_back()
        return faults, words, time.monotonic() - started

    def said(self, faults, of, act):
        """Return the result of ``act``, or its InputError; add any other error to the faults."""
        try:
            return act()
        except InputError as error:
            return error
        except Exception:
            faults.append(f"{of}: {traceback.format_exc()}")
            return None

    def put_back(self):
        """Restore the store, and remove new files beside it."""
        restore(self.path, self.kept)
        for there in self.folder.iterdir():
            if there.name not in self.beside:
                shutil.rmtree(there) if there.is_dir() else there.unlink()


def main():
    """Run the trials and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--damages", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--unvouched", action="store_true", help="use a store of version 0.1")
    parser.add_argument("--only", type=int, help="number of the only damage to apply")
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
