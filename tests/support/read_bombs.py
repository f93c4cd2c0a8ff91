"""Read small files, and print each refusal and the largest memory of this process.

    python tests/support/read_bombs.py FOLDER NAME...

The memory is that of the whole process, imports included.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import bombs

from twinct.core.errors import TwinctError


def reader(name: str) -> Callable[[Path, Path], object]:
    """Return the function that reads a file as the program does, with its imports done."""
    if any(name == make.__name__ for make in bombs.IMPORTED):
        from twinct.link.recording.arms_recording import ArmsRecording
        from twinct.measured import description_of, import_measured
        from twinct.measured.driven import import_driven

        if name == "mcap":
            return lambda path, out: import_driven([path], out, ArmsRecording())
        return lambda path, out: import_measured(description_of(path), out)
    if any(name == make.__name__ for make in bombs.BODIES):
        from twinct.scenario import CtVolume, MeshFile
        from twinct.specimen.shapes import shape_surface

        def body(path: Path, out: Path) -> object:
            del out
            if name == "ply":
                return shape_surface(MeshFile(kind="mesh", path=path), "body")
            return shape_surface(CtVolume(kind="ct", path=path), "body")

        return body
    from twinct.core.files.arm_xml import read_arm_xml

    return lambda path, _: read_arm_xml(path, "cell.detector_arm.file")


def tried(name: str, folder: Path) -> tuple[str, int, int]:
    """Return the refusal, the largest memory and the file's size, bytes."""
    folder.mkdir()
    path, read = getattr(bombs, name)(folder), reader(name)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    Path("/proc/self/clear_refs").write_text("5")  # forget the largest memory of making the file
    refusal = ""
    try:
        read(path, folder / "out")
    except TwinctError as error:
        refusal = str(error)
    status = Path("/proc/self/status").read_text()
    peak = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    return refusal, 1024 * peak, size


def main() -> None:
    """Read the files, and print what happened as JSON."""
    folder, names = Path(sys.argv[1]), sys.argv[2:]
    results = {name: tried(name, folder / name) for name in names}
    sys.stdout.write(json.dumps(results) + "\n")


if __name__ == "__main__":
    main()
