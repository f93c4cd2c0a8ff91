"""Measured circular scans without a truth: the errors of a scanner, found from projections alone.

    python benchmarks/bench_circle.py [--scans 20] [--photons 5e4] [--first 0] [--views 48]
    python benchmarks/bench_circle.py --walnut

Objects are the ten of the zoo that fit into a round field of view, two scans each: exact rays,
averaged in pixels, and counted photons. The scanner is off by 3 px of its axis, 0.5 deg of roll,
tilt and slant, 1 mm of SOD and SDD, each with a drawn sign, and 2 px of height. Images and nominal
numbers are imported as any measured scan, then ``twinct calibrate circle`` runs on the folder.

Told of each scan: by how much axis and roll are missed, where points of the object project, RMS
over both image axes, after the best similarity, as imported and as found; the errors of all six
numbers in their stated standard deviations; what is named as undetermined; processor seconds.
``--walnut`` (after ``tools/fetch-walnut``) calibrates the measured walnut as it is, and with its
panel moved by 3 pixels: the difference is what counts, as nobody knows where its axis is.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
import time
from pathlib import Path

import numpy as np
import zoo_objects
from zoo_scans import MATERIALS, MONO_KEV
from zoo_shapes import packed, path_lengths

from twinct.calibration import aligned, circle_numbers
from twinct.calibration.calibrate import calibrate
from twinct.geometry import ScanGeometry
from twinct.measured import description_of, import_measured
from twinct.measured.circle import Circle
from twinct.measured.views import ImageFacts

ROOT = Path(__file__).parents[1]
OBJECTS = ("foam", "trabecular", "gradients", "sheets", "wires", "board", "casting", "tissue",
           "tooth", "mixture")  # fmt: skip
PIXELS, PITCH = 128, 1.2
NOMINAL = {
    "kind": "circle",
    "sod_mm": 250.0,
    "sdd_mm": 500.0,
    "pitch_mm": PITCH,
    "rotates": "object",
    "direction": "counterclockwise",
    "rows": "up",
}
POINTS = 20.0 * np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1], [-1, 0, 1], [0, -1, -1]]
)


def nominal(views: int) -> dict:
    return {**NOMINAL, "angles": {"step": 360 / views}}


def circle(views: int, **keys) -> ScanGeometry:
    section = Circle.model_validate({**nominal(views), **keys})
    return section.views(ImageFacts(views, PIXELS, PIXELS)).geometry


def wrong(rng: np.random.Generator) -> dict:
    """Return the scanner's true numbers."""
    sign = rng.choice([-1, 1], 7)
    return {
        "sod_mm": 250.0 + sign[0],
        "sdd_mm": 500.0 + sign[1],
        "panel_offset_mm": (3 * PITCH * sign[2], 2 * PITCH * sign[3]),
        "panel_roll_deg": 0.5 * sign[4],
        "panel_tilt_deg": 0.5 * sign[5],
        "panel_slant_deg": 0.5 * sign[6],
    }


def images(shapes, geometry: ScanGeometry, photons: float, rng) -> np.ndarray:
    """Return transmissions: four rays of each pixel are averaged, then photons are counted."""
    names = sorted({shape.material for shape in shapes})
    arrays = packed(shapes, names)
    mus = np.array([MATERIALS[name].mu_per_mm(MONO_KEV) for name in names])
    found, panel = [], geometry.panel.divided(2)
    for view in geometry:
        fine = ScanGeometry(view.source, view.detector, view.u, view.v, panel)
        to = fine.pixel_centres(0).reshape(-1, 3) - view.source[0]
        to /= np.linalg.norm(to, axis=1, keepdims=True)
        lengths = np.zeros((len(names), len(to)))
        path_lengths(view.source[0].copy(), to, *arrays, lengths)
        light = np.exp(-mus @ lengths).reshape(PIXELS, 2, PIXELS, 2).mean(axis=(1, 3))
        found.append(np.maximum(rng.poisson(photons * light), 0.5) / photons)
    return np.array(found, np.float32)


def simulated(number: int, photons: float, views: int) -> dict:
    """Simulate, import and calibrate one scan."""
    rng = np.random.default_rng([38, number])
    name = OBJECTS[number % len(OBJECTS)]
    executed = circle(views, **wrong(rng))
    stack = images(getattr(zoo_objects, name)(rng), executed, photons, rng)
    with tempfile.TemporaryDirectory() as scratch:
        np.save(Path(scratch) / "images.npy", stack)
        section = {"path": str(Path(scratch) / "images.npy"), "values": "transmissions"}
        folder = Path(scratch) / "scan"
        with contextlib.redirect_stderr(io.StringIO()):
            import_measured({"name": name, "images": section, "geometry": nominal(views)}, folder)
        start = time.process_time()
        found = calibrate(folder, "circle")
        seconds = time.process_time() - start
    truth = circle_numbers(executed)
    after, pitch = found.after, PITCH
    off = np.array(
        [
            (after.axis_px - truth.axis_px) * pitch,
            (after.height_px - truth.height_px) * pitch,
            after.sdd_mm - truth.sdd_mm,
            *np.radians(
                [
                    after.panel_tilt_deg - truth.panel_tilt_deg,
                    after.panel_slant_deg - truth.panel_slant_deg,
                    after.panel_roll_deg - truth.panel_roll_deg,
                ]
            ),
        ]
    )
    return {
        "name": name,
        "axis": abs(off[0]) / pitch,
        "roll": abs(after.panel_roll_deg - truth.panel_roll_deg),
        "before": aligned(circle(views), executed, POINTS).after_px,
        "after": aligned(found.geometry, executed, POINTS).after_px,
        "pulls": off / found.deviation,
        "undetermined": found.undetermined,
        "uncertain": found.uncertain,
        "seconds": seconds,
    }


def scans(first: int, number: int, photons: float, views: int) -> None:
    """Print a line for each scan, and the worst of all."""
    told = []
    for one in range(first, first + number):
        told.append(simulated(one, photons, views))
        line = told[-1]
        named = "; ".join(f"{100 * u.left:.0f} %: {u}" for u in line["undetermined"])
        named = "; ".join([named, *line["uncertain"]])
        print(
            f"{one} {line['name']}: axis {line['axis']:.3f} px, roll {line['roll']:.4f} deg, "
            f"points {line['before']:.2f} -> {line['after']:.3f} px, errors / sigma "
            f"{np.round(line['pulls'], 1).tolist()}, {line['seconds']:.1f} s; {named}",
            flush=True,
        )
    for key, limit in (("axis", 0.1), ("roll", 0.03), ("after", 0.1)):
        values = np.array([line[key] for line in told])
        print(
            f"{key}: median {np.median(values):.4f}, largest {values.max():.4f}, "
            f"{int((values <= limit).sum())} of {len(values)} within {limit}"
        )


def walnut() -> None:
    """Calibrate the walnut with its panel where it is, and moved by three pixels."""
    found = {}
    for moved in (0.0, 3.0):
        told = description_of(ROOT / "examples" / "walnut.yaml")
        pitch = 0.4
        geometry = told.geometry.model_copy(update={"panel_offset_mm": (moved * pitch, 0.0)})
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / "scan"
            import_measured(told.model_copy(update={"geometry": geometry}), folder)
            start = time.process_time()
            one = calibrate(folder, "circle")
        found[moved] = one.after.axis_px
        print(
            f"panel moved by {moved:+.0f} px: axis {one.before.axis_px:+.3f} -> "
            f"{one.after.axis_px:+.3f} +- {one.deviation[0] / pitch:.3f} px, roll "
            f"{one.after.panel_roll_deg:+.3f}, tilt {one.after.panel_tilt_deg:+.2f}, slant "
            f"{one.after.panel_slant_deg:+.2f} deg, SDD {one.after.sdd_mm:.2f} mm, "
            f"{time.process_time() - start:.0f} s; {[str(u) for u in one.undetermined]}",
            flush=True,
        )
    print(f"difference: {np.ptp(list(found.values())):.3f} px")


def main() -> None:
    """Run the scans, or the walnut."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--photons", type=float, default=5e4)
    parser.add_argument("--views", type=int, default=48)
    parser.add_argument("--walnut", action="store_true")
    told = parser.parse_args()
    if told.walnut:
        walnut()
    else:
        scans(told.first, told.scans, told.photons, told.views)


if __name__ == "__main__":
    main()
