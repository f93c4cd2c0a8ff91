"""Read the test files in the wheels of pydicom and nibabel as CT volumes.

    python tests/support/read_wheels.py           # a line for each file, then the sums
    python tests/support/read_wheels.py --json    # the same for programs

A DICOM file is read as a folder; one image is written twice, one slice apart, as a volume needs
two. Folders are read as series. Everything is read twice: as it is, and as a part reads it whose
key ``hu`` says that its values are HU. The exit code is 1 if a file ends with anything but a volume
or a message.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pydicom

from twinct.core.errors import InputError
from twinct.scenario import HuLine
from twinct.specimen.dicom_files import silent_library
from twinct.specimen.volumes import read_ct

WHEELS = {"pydicom": ("data",), "nibabel": ("tests/data", "nicom/tests/data")}
"""Packages, and their folders of test files."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one file: ``read``, ``refused`` or ``failed``.

    ``source`` is the path that was read. ``peak_mb`` is the largest memory of the process so far.
    """

    path: str
    source: str
    stated: bool
    outcome: str
    told: str
    peak_mb: float


def sources() -> list[Path]:
    """Return the test files in both wheels, and the folders that hold several.

    Raises:
        FileNotFoundError: a package is not installed, or has no test files.
    """
    found: list[Path] = []
    for package, folders in WHEELS.items():
        spec = find_spec(package)
        root = Path(spec.origin).parent if spec and spec.origin else Path(package)
        for folder in folders:
            if not (root / folder).is_dir():
                raise FileNotFoundError(f"{root / folder}: no test files")
            inside = [p for p in sorted((root / folder).rglob("*")) if "__pycache__" not in p.parts]
            found += [p for p in inside if p.is_file() and p.suffix != ".py"]
            found += [p for p in inside if p.is_dir() and sum(q.is_file() for q in p.iterdir()) > 1]
    return found


def as_input(path: Path, folder: Path) -> Path:
    """Return the path that reads a file: itself, or for DICOM a new folder with it."""
    if path.is_dir():
        return path
    with path.open("rb") as stream:
        if stream.read(132)[128:] != b"DICM" and path.suffix != ".dcm":
            return path
    folder.mkdir()
    (folder / path.name).symlink_to(path)
    with contextlib.suppress(Exception):  # no image, or none with a place
        data: Any = pydicom.dcmread(path)
        axes = np.array(data.ImageOrientationPatient, dtype=float).reshape(2, 3)
        next_one = np.array(data.ImagePositionPatient, dtype=float) + 2 * np.cross(axes[0], axes[1])
        data.ImagePositionPatient = [f"{n:.6f}" for n in next_one]
        data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID = "1.2.3.4"
        data.save_as(folder / f"next-{path.name}")
    return folder


def outcomes(space: Path) -> Iterator[Outcome]:
    """Read every file with and without a stated line to HU; folders are made in ``space``."""
    with silent_library():
        for number, path in enumerate(sources()):
            source = as_input(path, space / str(number))
            for line in (None, HuLine()):
                try:
                    image = read_ct(source, "it", line)
                    outcome, told = "read", " x ".join(map(str, image.values.shape))
                except InputError as error:
                    outcome, told = "refused", str(error)
                except Exception as error:
                    outcome, told = "failed", f"{type(error).__name__}: {error}"
                peak = _peak_mb()
                stated = line is not None
                yield Outcome(str(path), str(source), stated, outcome, told, peak)


def _peak_mb() -> float:
    """Return the largest memory of this process, MB; ``getrusage`` also counts its parent's."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def main() -> int:
    """Print the outcomes; return 1 if a file failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="one JSON object for each reading")
    parser.add_argument("--keep", type=Path, help="folder for what is made of images")
    arguments = parser.parse_args()
    found: list[Outcome] = []
    with tempfile.TemporaryDirectory() as space:
        for one in outcomes(arguments.keep or Path(space)):
            found.append(one)
            stated = " (hu stated)" if one.stated else ""
            text = f"{one.outcome} {one.path}{stated}: {one.told}"
            print(json.dumps(asdict(one)) if arguments.json else text)
    if not arguments.json:
        print(summary(found))
    return int(any(one.outcome == "failed" for one in found))


def summary(found: list[Outcome]) -> str:
    """Return the sums, and the largest memory."""
    lines = [
        f"{'hu stated' if stated else 'as they are'}: "
        + ", ".join(
            f"{sum((o.outcome, o.stated) == (name, stated) for o in found)} {name}"
            for name in ("read", "refused", "failed")
        )
        for stated in (False, True)
    ]
    lines.append(f"most memory: {max(one.peak_mb for one in found):.0f} MB")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
