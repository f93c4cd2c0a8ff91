"""How well arms calibrated by a phantom of balls tell where source and panel are at unseen poses.

python benchmarks/bench_kinematics.py                    60 views, 50 unseen poses, several arms
python benchmarks/bench_kinematics.py --views 20 40 60   by how many views
python benchmarks/bench_kinematics.py --rendered         one scan of balls, its images through gVXR

Views and unseen poses are drawn over what both arms can hold, clear of the room and each other:
directions all over the sphere, 260 to 400 mm from source and panel to a point about the isocentre,
any roll, any configuration of the arms. The arms are those of the collaborative preset. No image is
rendered: the shadows of the balls lie where the executed geometry projects them, off by SHADOW_PX,
from balls off by TOLERANCE_MM; source and panel are told from them as from a scan's. With
--rendered 60 views of balls.yaml are scanned, and the arms are judged along the paper's path. With
--rails both arms stand on rails of 2 m, and views are drawn over all places of their carriages.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from twinct.calibration import PhantomViews, Shadows, calibrated_arms, resected
from twinct.calibration.arm_calibration import Kinematics, arm_prior, view_covariance
from twinct.calibration.calibrate import calibrate
from twinct.calibration.scan_calibration import phantom_of
from twinct.calibration.shadows import overlapping, shadow_radius_px
from twinct.core.errors import CalibrationError
from twinct.geometry import Pose, ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import chains_of
from twinct.robots.reach import Holder, TargetPoses
from twinct.runs import load_scan, run
from twinct.scan import SimulationBuilder
from twinct.scenario import Uncertainty, ViewErrors, load_scenario
from twinct.trajectory import panel_axes
from twinct.uncertainty import TrueCell
from twinct.uncertainty.nominal_scan import NominalScan

SCENARIO = Path(__file__).parents[1] / "scenarios" / "balls.yaml"
SHADOW_PX = 0.01
"""What a shadow's place is off by along each axis; at 1e4 photons bench_beads.py finds less."""
TOLERANCE_MM = 0.01
RADII_MM = 260.0, 400.0
ABOUT_MM = 15.0


RAILS = [f"cell.{side}_arm.rail={{range_mm: [-1000, 1000]}}" for side in ("source", "detector")]


def drawn_joints(builder, count, rng):
    """So many configurations of both arms, rad, over what they can hold with the phantom seen."""
    holder = Holder(builder.cell, builder.scenario.motion, rolls=4, seed=int(rng.integers(1e9)))
    found = []
    while len(found) < count:
        directions = rng.normal(size=(4 * count, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        directions = directions[np.abs(directions[:, 2]) < 0.98]
        size = len(directions), 1
        u, v = panel_axes(directions)
        roll = rng.uniform(0, 2 * np.pi, size)
        u, v = np.cos(roll) * u + np.sin(roll) * v, np.cos(roll) * v - np.sin(roll) * u
        middle = rng.normal(0, ABOUT_MM, (len(directions), 3))
        geometry = ScanGeometry(
            middle + rng.uniform(*RADII_MM, size) * directions,
            middle - rng.uniform(*RADII_MM, size) * directions,
            *(u, v, builder.scenario.detector.panel),
        )
        poses = TargetPoses.of(geometry)
        of_arms = holder.alone(poses.source, 0), holder.alone(poses.detector, 1)
        for view in range(len(poses)):
            pairs = holder.pairs(*of_arms, view, 16)
            if len(pairs):
                found.append(pairs[rng.integers(len(pairs))])
    return np.array(found[:count])


def executed_of(true_cell, chains, joints, panel, first_view):
    """Where true arms are at rest in these configurations."""
    told = PosePairs(*(tuple(poses) for poses in nominal(chains, joints)))
    pairs = []
    for k in range(len(told)):
        at = PosePairs.at(*told[k], Pose.identity())
        pairs.append(true_cell.at(at, first_view + k, 0.0, joints[k], np.zeros_like(joints[k])))
    return PosePairs.joined(pairs).geometry(panel)


def nominal(chains, joints):
    """What the controllers make of encoders."""
    first = len(chains[0])
    for chain, own in zip(chains, (joints[:, :first], joints[:, first:]), strict=True):
        yield [Pose.from_matrix(at[:3, 3], at[:3, :3]) for at in chain.tools(own)]


def seen_in(executed, joints, phantom, own, rng):
    """What the shadows of a phantom off by its tolerance tell of each view."""
    centres = phantom.centres + rng.normal(0, TOLERANCE_MM, phantom.centres.shape)
    known, kept = [], []
    panel = executed.panel
    for view in range(len(executed)):
        one = executed[view]
        pixels = one.project(centres)[0]
        inside = ((pixels >= 8) & (pixels <= (panel.columns - 9, panel.rows - 9))).all(axis=1)
        pixels[~inside] = np.nan
        alone = inside & ~overlapping(pixels, shadow_radius_px(one, phantom))
        balls = np.flatnonzero(alone)
        seen = pixels[balls] + rng.normal(0, SHADOW_PX, (len(balls), 2))
        spread = np.broadcast_to(SHADOW_PX**2 * np.eye(2), (len(balls), 2, 2))
        try:
            known.append(resected(phantom, Shadows(balls, seen, spread), one))
        except CalibrationError:
            continue
        kept.append(view)
    covariance = np.stack([one.covariance + own for one in known])
    return PhantomViews(
        joints[kept], ScanGeometry.joined([one.geometry for one in known]), covariance
    )


def off_mm(executed, source, detector):
    """RMS distance of source and of panel centre."""
    pairs = (executed.source, source), (executed.detector, detector)
    return [float(np.sqrt(((a - b) ** 2).sum(axis=1).mean())) for a, b in pairs]


def rendered(views, rails):
    """Both arms from a whole scan; what that makes of the paper's path, 40 views."""
    builder = SimulationBuilder(load_scenario(SCENARIO, rails))
    chains = chains_of(builder.cell)
    joints = drawn_joints(builder, views, np.random.default_rng(3))
    places = [np.array([p.position for p in side]) for side in nominal(chains, joints)]
    keys = [
        "uncertainty={preset: collaborative, arms: {seed: 7}, source: {sigma_mm: 0}, "
        "detector: {sigma_mm: 0}}",
        "motion.trigger=settled",
        "reconstruction={iterations: 1, grid: {voxels: 16, voxel_mm: 10}}",
        *rails,
    ]
    with TemporaryDirectory() as folder:
        table, balls, path = (Path(folder) / name for name in ("views.csv", "balls", "path"))
        np.savetxt(table, np.hstack(places), delimiter=",")
        drawn = [f"trajectory={{kind: file, path: {table}}}", "motion.order=shortest"]
        run(load_scenario(SCENARIO, [*keys, *drawn]), balls, link="local")
        later = ["trajectory.views=40", "seed=2"]
        run(load_scenario(SCENARIO.with_name("demo.yaml"), [*keys, *later]), path, link="local")
        found = calibrate(balls, Kinematics(to=(path,)))
        scan = load_scan(path)
    executed = scan.executed.geometry(scan.scenario.detector.panel)
    for name in ("believed", "kinematics"):
        poses = scan.poses(name)
        places = [np.array([p.position for p in side]) for side in (poses.source, poses.detector)]
        off = off_mm(executed, *places)
        sys.stdout.write(f"{name}: source, panel {off[0]:.3f}, {off[1]:.3f} mm RMS\n")
    sys.stdout.write(f"{found.views} of {views} views used, misfit {found.misfit:.2f}\n")


def main() -> None:
    """Print RMS errors at unseen poses, nominal and calibrated, of several arms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, nargs="+", default=[60])
    parser.add_argument("--unseen", type=int, default=50)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--preset", default="collaborative")
    parser.add_argument(
        "--untold", action="store_true", help="list what the views do not determine"
    )
    parser.add_argument("--rendered", action="store_true", help="calibrate from rendered images")
    parser.add_argument("--rails", action="store_true", help="both arms on rails of 2 m")
    asked = parser.parse_args()
    rails = RAILS if asked.rails else []
    if asked.rendered:
        rendered(asked.views[0], rails)
        return
    scenario = load_scenario(SCENARIO, rails)
    builder, phantom = SimulationBuilder(scenario), phantom_of(scenario.specimen)
    chains, panel = chains_of(builder.cell), scenario.detector.panel
    section = Uncertainty.model_validate({"preset": asked.preset})
    quiet = section.model_copy(update={"views": ViewErrors()})
    step = np.radians(section.encoder_step_deg)
    hinges = np.concatenate([chain.hinges for chain in chains]) > 0  # rails are read exactly
    home = np.zeros((1, sum(map(len, chains))))
    still = NominalScan.of_arms(chains, home, home, np.zeros(1))
    motions = still.motion(0), still.motion(1)
    priors = arm_prior(section, motions[0]), arm_prior(section, motions[1])
    errors = {views: [] for views in asked.views}
    for seed in range(asked.seeds):
        rng = np.random.default_rng(seed)
        joints = drawn_joints(builder, max(asked.views) + asked.unseen, rng)
        encoders = np.where(hinges, step * np.round(joints / step), joints)
        new, read = joints[-asked.unseen :], encoders[-asked.unseen :]
        cells = [TrueCell(one, seed, seed, chains) for one in (section, quiet)]
        unseen = [executed_of(cell, chains, new, panel, 10_000) for cell in cells]
        believed = [np.array([p.position for p in side]) for side in nominal(chains, read)]
        for views in asked.views:
            executed = executed_of(cells[0], chains, joints[:views], panel, 0)
            begun = time.perf_counter()
            seen = seen_in(
                executed, encoders[:views], phantom, view_covariance(section, motions), rng
            )
            half = time.perf_counter()
            found = calibrated_arms(chains, seen, priors, gear_periods=section.arms.gear_periods)
            seconds = half - begun, time.perf_counter() - half
            places = [tools[:, :3, 3] for tools in found.arms.tools(read)]
            before, after = off_mm(unseen[0], *believed), off_mm(unseen[0], *places)
            mean = off_mm(unseen[1], *places)
            errors[views].append((before, after, mean))
            sys.stdout.write(
                f"seed {seed}, {len(seen)} of {views} views: source, panel RMS "
                f"{before[0]:.2f}, {before[1]:.2f} mm -> {after[0]:.3f}, {after[1]:.3f} mm "
                f"(without repeatability {mean[0]:.3f}, {mean[1]:.3f}); at the views left out "
                f"{found.predicted_mm[0]:.3f}, {found.predicted_mm[1]:.3f}; misfit "
                f"{found.misfit:.2f}, {len(found.undetermined)} combinations left to the prior; "
                f"{seconds[0]:.1f} + {seconds[1]:.1f} s\n"
            )
            for one in found.undetermined if asked.untold else ():
                sys.stdout.write(f"  {one.left:.3f}  {one}\n")
            sys.stdout.flush()
    for views, rows in errors.items():
        before, after, mean = np.sqrt((np.array(rows) ** 2).mean(axis=0))
        worst = np.array(rows)[:, 1].max(axis=0)
        sys.stdout.write(
            f"{views} views, {asked.seeds} arms: source, panel {before[0]:.2f}, {before[1]:.2f} mm "
            f"-> {after[0]:.3f}, {after[1]:.3f} mm, at most {worst[0]:.3f}, {worst[1]:.3f} mm; "
            f"without repeatability {mean[0]:.3f}, {mean[1]:.3f} mm\n"
        )


if __name__ == "__main__":
    main()
