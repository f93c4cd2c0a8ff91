"""Damage to the files of a scan store, of many kinds."""

import contextlib
import hashlib
import json
import os
import shutil

from twinct.scan.manifest import FRAME_FILE, VIEWS, sealed, unsealed

VALUES = [None, 0, 1, -1, 99, 10**12, 0.5, 1e308, "", "x", "NaN", [], [1], {}, True, "f8", "10"]
STRANGERS = [".DS_Store", "notes.txt", "zarr.json~", ".zarr.json.swp", "c.10.0.0", "c", "deep/er/x"]


def contents(path):
    """Return everything below a folder: the bytes of files, the kind of all other entries."""
    return {str(p.relative_to(path)): what(p) for p in sorted(path.rglob("*"))}


def what(path):
    """Return the bytes of a file or of a link's target; for anything else, the name of its kind."""
    if path.is_file():
        return path.read_bytes()
    if path.is_symlink():
        return f"link to {os.readlink(path)}"
    return "folder" if path.is_dir() else "special"


def files(path):
    """Return the names of all files of a store."""
    return [str(p.relative_to(path)) for p in sorted(path.rglob("*")) if p.is_file()]


def drawn(rng, path, of=""):
    """Return a random file of the store, often one of the few that belong to no view."""
    names = [name for name in files(path) if of in name and (path / name).stat().st_size]
    few = [name for name in names if "/c." not in name]
    return path / rng.choice(few if few and rng.random() < 0.5 else names)


def bit(rng, path):
    """Flip one bit of a file."""
    file = drawn(rng, path)
    data = bytearray(file.read_bytes())
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    file.write_bytes(data)


def bytes_(rng, path):
    """Overwrite adjacent bytes of a file."""
    file = drawn(rng, path)
    data = bytearray(file.read_bytes())
    first = rng.randrange(len(data))
    last = min(len(data), first + rng.choice([1, 8, 64, 4096]))
    data[first:last] = rng.randbytes(last - first)
    file.write_bytes(data)


def cut(rng, path):
    """Truncate a file, or empty it."""
    file = drawn(rng, path)
    file.write_bytes(file.read_bytes()[: rng.choice([0, rng.randrange(file.stat().st_size)])])


def grown(rng, path):
    """Append bytes to a file."""
    file = drawn(rng, path)
    file.write_bytes(file.read_bytes() + rng.choice([b"\0", b" ", b"\n", rng.randbytes(50)]))


def missing(rng, path):
    """Delete a file."""
    drawn(rng, path).unlink()


def folder_missing(rng, path):
    """Delete a folder and its contents."""
    shutil.rmtree(rng.choice([p for p in sorted(path.rglob("*")) if p.is_dir()]))


def exchanged(rng, path):
    """Exchange two files, more often two of the same array."""
    one = drawn(rng, path)
    alike = [p for p in one.parent.iterdir() if p.is_file() and p != one]
    other = rng.choice(alike) if alike and rng.random() < 0.7 else drawn(rng, path)
    a, b = one.read_bytes(), other.read_bytes()
    one.write_bytes(b)
    other.write_bytes(a)


def copied(rng, path):
    """Copy one file over another."""
    one, other = drawn(rng, path), drawn(rng, path)
    other.write_bytes(one.read_bytes())


def other_kind(rng, path):
    """Replace a file with a folder, link or pipe, or a folder with a file."""
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
    """Change one value in the metadata of the store or of an array."""
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
    """Change, remove or add one value in nested mappings and lists."""
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


def seal_anew(path):
    """Recompute the digests of all files, so that only a check of the values can detect damage."""
    for manifest in (path / FRAME_FILE, *sorted((path / VIEWS).glob("c.*"))):
        if not manifest.is_file():
            continue
        with contextlib.suppress(ValueError):  # the manifest itself is damaged
            text = manifest.read_bytes()
            known = unsealed(text)
            now = {n: d if not (path / n).is_file() else digest(path / n) for n, d in known.items()}
            manifest.write_bytes(sealed(now, 0 if manifest.name == "0" else len(text)))


def digest(file):
    """Return the SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def resealed(rng, path):
    """Change one value in the metadata and recompute the digests."""
    metadata(rng, path)
    seal_anew(path)


def added(rng, path):
    """Add a file, folder, link or pipe that does not belong to the store."""
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
