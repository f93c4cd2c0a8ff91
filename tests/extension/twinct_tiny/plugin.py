"""An export format from outside the package: a scan in one NumPy file."""

from pathlib import Path

import numpy as np

from twinct.core.errors import InputError
from twinct.exchange import Bundle, Format

MOST_VIEWS = 1000

LOAD = '''"""Load scan.npz, which lies beside this file."""

from pathlib import Path

import numpy as np

scan = np.load(Path(__file__).with_name("scan.npz"))
print(len(scan["images"]), "views")
'''


def _check(bundle: Bundle) -> None:
    if len(bundle.geometry) > MOST_VIEWS:
        raise InputError(f"{len(bundle.geometry)} views: plugin takes at most {MOST_VIEWS}")


def _write(bundle: Bundle, folder: Path) -> None:
    images, matrices = np.stack(list(bundle.images)), bundle.local.matrices()
    np.savez(folder / "scan.npz", images=images, matrices=matrices)


PLUGIN = Format(
    "plugin",
    "one NumPy file",
    {"scan.npz": "images (view, row, column) and matrices (view, 3, 4)"},
    _write,
    LOAD,
    check=_check,
)
