"""How well a phantom of balls tells where source and panel were, through gVXR.

python benchmarks/bench_beads.py left-out      balls left out of the fit, against executed geometry
python benchmarks/bench_beads.py poses         errors and ellipsoids over phantoms and views
python benchmarks/bench_beads.py volumes       the skull at the same poses, reconstructed

Source and panel stand exactly where they are told (a gantry), 4 x 4 samples a pixel; what is
believed of them is off by sigma 1 mm and 0.5 deg, independent for each axis and view.
"""

import argparse
from pathlib import Path

import numpy as np
from bench_selfcal import best
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from twinct.calibration import PARAMETERS, aligned, calibrated, calibrated_view, moved
from twinct.calibration.scan_calibration import phantom_of
from twinct.evaluation import image_figures, region_of_interest
from twinct.geometry import ScanGeometry
from twinct.runs import simulate
from twinct.scan import SimulationBuilder, line_integrals
from twinct.scenario import load_scenario, parse_scenario
from twinct.trajectory import OrbitSettings
from twinct.xray.build import effective_energy_kev

SCENARIO = Path(__file__).parents[1] / "scenarios" / "balls.yaml"
SIGMA_MM, SIGMA_DEG = 1.0, 0.5
BLUR_PX = 1.0
TOLERANCE_MM = 0.01
PHOTONS = 1e4


def scan_of(views, phantom, *, tolerance_mm=0.0, noisy=False, blurred=False):
    """A scan of one phantom, and its scenario."""
    told = [
        "cell={kind: gantry}",
        "motion.scheme=reactive",
        f"trajectory.views={views}",
        f"seed={phantom}",
        f"specimen.parts.0.shape.tolerance_mm={tolerance_mm}",
        f"specimen.parts.0.shape.tolerance_seed={phantom}",
    ]
    base = load_scenario(SCENARIO, told)
    panel, trajectory = base.detector.panel, base.trajectory
    assert isinstance(trajectory, OrbitSettings)
    if noisy:
        metres = float(trajectory.sdd_at(0.5)) / 1000
        at_a_metre = PHOTONS / (panel.pitch_u * panel.pitch_v) * metres**2
        told.append(f"source.photons_per_mm2_mas={at_a_metre / base.source.mas}")
        told.append("detector.noise={kind: quantum}")
    if blurred:
        sigma_mm = panel.pitch_u * BLUR_PX
        told.append(f"detector.point_spread={{kind: gaussian, sigma_mm: {sigma_mm}}}")
    scenario = load_scenario(SCENARIO, told)
    return scenario, simulate(scenario)


def believed_of(executed, rng):
    """What is believed of one view."""
    sigma = np.array([SIGMA_MM] * 6 + [np.radians(SIGMA_DEG)] * 3)
    return moved(executed, sigma * rng.normal(size=9))


def left_out(views):
    """Every second ball is fitted; where are the others seen?"""
    for name, noisy in (("no noise", False), ("1e4 photons, blur 1 px", True)):
        scenario, scan = scan_of(views, 0, noisy=noisy, blurred=noisy)
        truth = phantom_of(scenario.specimen)
        executed = scan.executed.geometry(scenario.detector.panel)
        far, before = [], []
        for view in range(views):
            rng = np.random.default_rng([0, view])
            believed = believed_of(executed[view], rng)
            fitted = rng.permutation(len(truth)) < len(truth) // 2
            found = calibrated_view(
                scan.transmission[view], believed, truth, balls=fitted, blur_px=BLUR_PX * noisy
            )
            rest = truth.centres[~fitted]
            there = executed[view].project(rest)[0]
            far.append(np.linalg.norm(found.geometry.project(rest)[0] - there, axis=1))
            before.append(np.linalg.norm(believed.project(rest)[0] - there, axis=1))
        far, before = np.concatenate(far), np.concatenate(before)
        print(
            f"{name}: median {np.median(far):.4f} px, 95 % {np.quantile(far, 0.95):.4f} px, "
            f"{len(far)} balls in {views} views; believed: {np.median(before):.2f} px",
            flush=True,
        )


def change_of(start, end):
    """What moves a view to another, in the axes of the first: ``PARAMETERS``."""
    axes = np.stack([start.u[0], start.v[0], start.normal[0]])
    there = np.stack([end.u[0], end.v[0], end.normal[0]])
    turn = Rotation.from_matrix(there.T @ axes).as_rotvec()
    return np.concatenate(
        [
            axes @ (end.source - start.source)[0],
            axes @ (end.detector - start.detector)[0],
            axes @ turn,
        ]
    )


def poses(views, phantoms):
    """Errors of all nine parameters, and how often the ellipsoids hold them."""
    errors, distances = [], []
    for phantom in range(phantoms):
        scenario, scan = scan_of(views, phantom, tolerance_mm=TOLERANCE_MM, noisy=True)
        nominal = phantom_of(scenario.specimen)
        executed = scan.executed.geometry(scenario.detector.panel)
        for view in range(views):
            believed = believed_of(executed[view], np.random.default_rng([1, phantom, view]))
            found = calibrated_view(scan.transmission[view], believed, nominal)
            off = change_of(found.geometry, executed[view])
            errors.append(off)
            distances.append(off @ np.linalg.solve(found.covariance, off))
        rms = np.sqrt(np.mean(np.square(errors), axis=0)) * ([1] * 6 + [180 / np.pi] * 3)
        inside = np.mean(np.array(distances) < chi2.ppf(0.95, 9))
        told = ", ".join(f"{n} {v:.4f}" for n, v in zip(PARAMETERS, rms, strict=True))
        print(
            f"{len(errors)} views: {told} (mm, deg); in the 95 % ellipsoid {inside:.1%}", flush=True
        )


def skull_of(views, voxels, phantom):
    """The skull's scenario: poses and panel of the phantom's, pixels twice as large."""
    panel = phantom.detector.panel
    return parse_scenario(
        {
            "cell": {"kind": "gantry"},
            "trajectory": phantom.trajectory.model_dump(exclude_unset=True),
            "detector": {
                "columns": panel.columns // 2,
                "rows": panel.rows // 2,
                "pixel_pitch_mm": 2 * panel.pitch_u,
            },
            "specimen": {"parts": [{"shape": {"kind": "skull"}, "material": "bone"}]},
            "reconstruction": {"grid": {"voxels": voxels, "voxel_mm": 204.8 / voxels}},
        }
    )


def volumes(views, voxels):
    """Bone from executed, calibrated and believed geometry, each at its best iteration.

    The skull's images are without noise, so that nothing but geometry stands between the volumes.
    """
    scenario, scan = scan_of(views, 0, tolerance_mm=TOLERANCE_MM, noisy=True)
    executed = scan.executed.geometry(scenario.detector.panel)
    believed = ScanGeometry.joined(
        [believed_of(view, np.random.default_rng([2, i])) for i, view in enumerate(executed)]
    )
    found = calibrated(scan.transmission, believed, phantom_of(scenario.specimen))
    for view, problem in found.problems.items():
        print(f"view {view}: {problem}", flush=True)

    skull = skull_of(views, voxels, scenario)
    builder = SimulationBuilder(skull)
    taken = simulate(skull, builder=builder)
    panel, grid = skull.detector.panel, skull.reconstruction.volume_grid
    there = taken.executed.geometry(panel)
    np.testing.assert_allclose(there.source, executed.source, atol=1e-9)
    np.testing.assert_allclose(there.detector, executed.detector, atol=1e-9)
    energy = effective_energy_kev(skull.source, skull.detector)
    truth = builder.specimen.truth(grid, energy, taken.stands)
    mu, region = builder.specimen.reference_mu(energy), region_of_interest(there, grid)
    p = line_integrals(taken.transmission)

    def near_bone(volume: NDArray[np.float32]) -> float:
        return image_figures(volume, truth, region, mu, grid).rmse_near_rel

    points = 30.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1]])
    # What is believed is moved as a whole to where the executed lies; what is found stays.
    for name, geometry in (
        ("executed", executed),
        ("calibrated", found.geometry),
        ("believed", aligned(believed, executed, points).geometry),
    ):
        off = np.linalg.norm(geometry.project(points) - executed.project(points), axis=2)
        error, at = best(geometry.binned(2, 2), p, near_bone, grid)
        print(
            f"{name}: RMSE within 3 mm of bone {error:.2%} of mu(bone) after {at} passes; "
            f"points of the region off by {np.sqrt(np.mean(off**2)):.3f} px (RMS, of "
            f"{scenario.detector.panel.pitch_u:g} mm)",
            flush=True,
        )


def main():
    """Run one of the three."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "what", choices=("left-out", "poses", "volumes"), nargs="?", default="left-out"
    )
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--phantoms", type=int, default=20)
    parser.add_argument(
        "--voxels", type=int, default=256, help="voxels along each edge of the skull's grid"
    )
    options = parser.parse_args()
    if options.what == "left-out":
        left_out(options.views)
    elif options.what == "poses":
        poses(options.views, options.phantoms)
    else:
        volumes(options.views, options.voxels)


if __name__ == "__main__":
    main()
