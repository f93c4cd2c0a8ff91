"""Plant links in the output of each command, and show that no file outside is touched.

Each command of ``tools/trials`` runs once undisturbed, in an empty folder or in a copy of a run.
Everything that it leaves there is a place, and so are the drafts of each, under the names that they
had when everybody knew them. Then the command runs again: with a link at every draft; and with one
link at a time at a place, to a file, to a folder, or to nothing. The links lead outside. A command
may end well, having replaced the link, or refuse it with exit code 2; nothing outside may change.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from commands import COMMANDS, begin, environment, line, prepare

LEFT_OUT = {"drive", "study on a cluster"}
"""Commands that need another one beside them, or a cluster."""
OWN = ("twinct.lock", "twinct.log", "seconds.json", "study.log", "checkpoints", "log", "work")
"""Names that a command takes away at its end, or that another run may have left."""


def drafts(name):
    """Return the names that the drafts of a file had."""
    suffix = "".join(Path(name).suffixes[-2:]) if name.endswith(".gz") else Path(name).suffix
    names = (f".{name}.partial{suffix}", f".{name}.partial", f"{name}.partial", f"{name}.new")
    return list(dict.fromkeys(names))


def places(out, before):
    """Return what a command made: not each view of a store, but each of its kinds."""
    found = {}
    for path in sorted(out.rglob("*")):
        name = str(path.relative_to(out))
        if name not in before:
            kind = "/".join("c" if part.startswith("c.") else part for part in Path(name).parts)
            found.setdefault(kind, name)
    return list(found.values())


class Outside:
    """A file and a folder that nobody may change."""

    def __init__(self, folder):
        self.folder = folder
        folder.mkdir()
        (folder / "file").write_text("mine")
        (folder / "inner").mkdir()

    def targets(self):
        """Return what a link may lead to."""
        return self.folder / "file", self.folder / "inner", self.folder / "new"

    @property
    def touched(self):
        """True if anything has changed."""
        there = sorted(str(p.relative_to(self.folder)) for p in self.folder.rglob("*"))
        return there != ["file", "inner"] or (self.folder / "file").read_text() != "mine"


def tried(command, made, place, links, target):
    """Run a command with links to one target; return its exit code, message, and the touched."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    outside, out = Outside(place / "outside"), place / "out"
    begin(command, made, out)
    for name in links:
        link = out / name
        if not link.parent.is_dir():
            link.parent.mkdir(parents=True)
        if link.is_dir() and not link.is_symlink():
            shutil.rmtree(link)
        link.unlink(missing_ok=True)
        link.symlink_to(outside.targets()[target])
    done = subprocess.run(
        line(command.words, made, out), env=environment({}), capture_output=True, text=True
    )
    said = done.stderr.strip().splitlines()[-1:] or [""]
    wrong = outside.touched or done.returncode not in (0, 2) or "bug in twinct" in done.stderr
    return done.returncode, said[0], wrong


def main():
    """Print a line for each command; end with 1 if anything outside was touched."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--commands", nargs="+", default=[n for n in COMMANDS if n not in LEFT_OUT])
    parser.add_argument("--places", type=int, default=4, help="places of each command, each alone")
    options = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        made, place = Path(name) / "made", Path(name) / "place"
        made.mkdir()
        prepare(made, options.commands)
        for which in options.commands:
            command = COMMANDS[which]
            place.mkdir()
            begin(command, made, place / "out")
            out = place / "out"
            before = {str(p.relative_to(out)) for p in out.rglob("*")}
            words = line(command.words, made, out)
            subprocess.run(words, env=environment({}), capture_output=True, check=True)
            found = places(out, before)
            top = [p for p in found if "/" not in p]
            # Deep places of a finished run are those of its store: a resumed run meets them.
            alone = [*top, *(p for p in found if "/" in p)][: options.places]
            names = [*dict.fromkeys([*top, *OWN])]
            planted = [str(Path(p).with_name(d)) for p in found for d in drafts(Path(p).name)] + [
                n for n in OWN if n not in before and n != "twinct.lock"
            ]
            new = [p for p in planted if Path(p).parent == Path(".")]
            told, count = Counter(), 0
            rounds = [(new, t) for t in (0, 2)] + [([p], t) for p in alone for t in (0, 1, 2)]
            rounds += [([n], 0) for n in names if n == "twinct.lock"]
            for links, target in rounds:
                code, said, wrong = tried(command, made, place, links, target)
                count += len(links)
                told["refused" if code == 2 else f"exit code {code}"] += 1
                if wrong:
                    failed += 1
                    print(f"{which}: {links[:3]} to {target}: exit code {code}: {said}", flush=True)
            shutil.rmtree(place)
            words = ", ".join(f"{n} {what}" for what, n in told.items())
            print(f"{which:<18} {count:4d} links: {words}", flush=True)
    print(f"{failed} runs touched anything outside, or ended otherwise")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
