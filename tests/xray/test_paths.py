"""Path lengths against chords, the imager and gVXR's own polychromatic mode."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage
from xray_scenes import body, box, chords, front_view, random_pose, random_view, specimen, sphere

from twinct.core.errors import SpecimenError, TwinctError
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.scenario import Detector, Source
from twinct.specimen.materials import material
from twinct.xray import Imager
from twinct.xray import paths as paths_module
from twinct.xray._placement import longest_edge
from twinct.xray.paths import PathRenderer

BONE, TITANIUM, WATER = (material(name) for name in ("bone", "titanium", "water"))
CHORD_MM = 0.02
"""As the imager's: the facets of the test sphere make 0.003 mm, rays at the rim the rest."""
FLOAT32_MM = 1e-3
"""gVXR's single-precision depths at 1 m."""
SLAB_MM = 2e-4
"""gVXR's single-precision depths at 600 mm: 3e-5 mm for each of two faces, and its projection."""


def test_each_body_moves_by_itself_and_paths_are_chords():
    panel = Panel(120, 160, 1.5, 1.6)
    radii = (30.0, 18.0, 12.0)
    bodies = [
        body(sphere((0, 0, 0), r, 6), m) for r, m in zip(radii, (BONE, TITANIUM, BONE), strict=True)
    ]
    rng = np.random.default_rng(1)
    with PathRenderer(bodies, panel) as renderer:
        assert renderer.materials == (BONE, TITANIUM)
        for _ in range(5):
            view = random_view(rng, panel, np.zeros(3))
            # Far apart across the beam: they may not overlap.
            poses = [
                Pose(random_pose(rng, 10).position + 60 * i * view.u[0], random_pose(rng, 1).quat)
                for i in (-0.5, 0.5, 1.5)
            ]
            found = renderer.render(view, poses)
            truth = [chords(view, p.position, r) for p, r in zip(poses, radii, strict=True)]
            for image, expected in zip(found, (truth[0] + truth[2], truth[1]), strict=True):
                assert np.abs(image - expected)[expected > 0].mean() < CHORD_MM
                assert image.min() >= 0


def test_slabs_are_as_thick_as_they_are(figure):
    panel = Panel(9, 9, 0.2, 0.2)
    view = front_view(panel)
    rays = view.pixel_centres(0) - view.source[0]
    oblique = np.linalg.norm(rays, axis=-1) / view.sdd
    worst = 0.0
    for thickness in (0.01, 0.1, 1.0, 10.0, 100.0, 400.0):
        slab = box((0, 0, 0), (thickness, 2, 2))
        with PathRenderer([body(slab, BONE)], panel) as renderer:
            for shift in (0.0, 7.3, -41.9):
                pose = Pose.from_euler((shift, 0, 0), (0, 0, 0))
                off = np.abs(renderer.render(view, pose)[0] - thickness * oblique).max()
                worst = max(worst, float(off))
    figure(f"slabs: at most {worst:.2g} mm off")
    assert worst < SLAB_MM


def test_samples_lie_at_the_centres_of_the_parts_of_a_pixel():
    panel, fine = Panel(30, 40, 3.0, 2.0), Panel(90, 120, 1.0, 2 / 3)
    bodies = [body(sphere((3, 4, 5), 20, 4), BONE)]
    with PathRenderer(bodies, panel, samples=3) as renderer:
        sampled = renderer.render(front_view(panel), Pose.identity())
    with PathRenderer(bodies, fine) as renderer:
        as_pixels = renderer.render(front_view(fine), Pose.identity())
    assert sampled.shape == (1, 90, 120)
    np.testing.assert_array_equal(sampled, as_pixels)


def test_a_large_panel_is_taken_in_tiles(monkeypatch):
    panel = Panel(50, 40, 3.0, 3.0)
    bodies = [body(sphere((3, 4, 5), 20, 4), BONE), body(sphere((0, -30, 5), 9, 3), BONE)]
    with PathRenderer(bodies, panel) as renderer:
        whole = renderer.render(front_view(panel), Pose.identity())
    monkeypatch.setattr(paths_module, "LARGEST_TILE", 13)
    with PathRenderer(bodies, panel) as renderer:
        tiles = renderer.render(front_view(panel), Pose.identity())
    # A ray may pass an edge between two facets on either side.
    np.testing.assert_allclose(tiles, whole, atol=5 * FLOAT32_MM)


def test_large_triangles_are_split(figure):
    """A bar along the beam, seen through its long sides: gVXR alone is off by millimetres."""
    panel = Panel(61, 81, 0.8, 0.8)
    view = ScanGeometry([[120, 6, 8]], [[-280, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], panel)
    size = np.array([100.0, 10.0, 10.0])
    rays = view.pixel_centres(0) - view.source[0]
    with np.errstate(divide="ignore"):
        ends = np.sort(np.stack([(s * size / 2 - view.source[0]) / rays for s in (-1, 1)]), axis=0)
    share = np.maximum(ends[1].min(axis=-1) - ends[0].max(axis=-1), 0.0)
    truth = share * np.linalg.norm(rays, axis=-1)
    inside = ndimage.binary_erosion(truth > 0, iterations=2)

    def error(edge):
        with PathRenderer([body(box((0, 0, 0), size), BONE)], panel, 1, edge) as renderer:
            found = renderer.render(view, Pose.identity())[0]
        return np.sqrt(np.mean((found - truth)[inside] ** 2))

    figure(f"RMS {error(None):.3f} mm, split {error(longest_edge(60)):.4f} mm")
    assert inside.sum() > 100
    assert error(None) > 0.3
    assert error(longest_edge(60)) < 0.05


def test_paths_agree_with_the_imager():
    panel = Panel(120, 160, 1.5, 1.5)
    ball, block = sphere((10, -4, 6), 25, 5), box((-30, 5, 0), (20, 15, 30))
    view = random_view(np.random.default_rng(5), panel, np.zeros(3))
    with PathRenderer(
        [body(ball, BONE), body(block, TITANIUM)], panel, 1, longest_edge(150)
    ) as renderer:
        bone, titanium = renderer.render(view, Pose.identity()).astype(float)
    detector = Detector(columns=160, rows=120, pixel_pitch_mm=1.5)
    with Imager(Source(), detector, specimen((ball, 0.043), (block, 0.18))) as imager:
        image = imager.render(view, Pose.identity())
    difference = np.abs(image - np.exp(-0.043 * bone - 0.18 * titanium))
    assert difference.max() < 1e-4
    assert image.min() < 0.1


def test_what_cannot_be_rendered_is_refused():
    panel = Panel(30, 40, 3.0, 3.0)
    ball = sphere((0, 0, 0), 10, 2)
    open_mesh = ball.copy()
    open_mesh.update_faces(np.arange(len(ball.faces)) > 0)
    with pytest.raises(SpecimenError, match="part .water. is an open mesh"):
        PathRenderer([body(ball, BONE), body(open_mesh, WATER)], panel)
    with pytest.raises(SpecimenError, match="nothing to image"):
        PathRenderer([], panel)
    with PathRenderer([body(ball, BONE)], panel) as renderer:
        with pytest.raises(ValueError, match="2 poses for 1 parts"):
            renderer.render(front_view(panel), [Pose.identity()] * 2)
        with pytest.raises(TwinctError, match="source is inside"):
            renderer.render(front_view(panel), Pose.from_euler((300, 0, 0), (0, 0, 0)))
    with pytest.raises(TwinctError, match="closed"):
        renderer.render(front_view(panel), Pose.identity())


@pytest.mark.process
def test_a_spectrum_agrees_with_gvxr_in_its_own_polychromatic_mode(figure):
    """In a process of its own, since it drives gVXR itself."""
    code = """
    import numpy as np
    from gvxrPython3 import gvxr
    from xray_scenes import body, box, front_view, sphere
    from twinct.geometry import Panel, Pose
    from twinct.specimen.materials import material
    from twinct.xray.gvxr import GVXR
    from twinct.xray.paths import PathRenderer
    from twinct.xray.response import PhotonResponse
    from twinct.xray.signal import Signal
    from twinct.xray.spectrum import PhotonSpectrum

    energies = np.linspace(21, 139, 60)
    photons = 1e6 * np.exp(-((energies - 60) / 30) ** 2)
    spectrum = PhotonSpectrum(energies, photons)
    panel = Panel(120, 160, 1.5, 1.5)
    view = front_view(panel)
    meshes = {"bone": sphere((0, -20, 6), 25, 5), "titanium": box((0, 25, 0), (20, 15, 30))}
    for names in (["bone"], ["bone", "titanium"]):
        bodies = [body(meshes[name], material(name)) for name in names]
        with PathRenderer(bodies, panel) as renderer:
            paths = renderer.render(view, Pose.identity())
            signal = Signal(spectrum, renderer.materials, PhotonResponse.integrating())
            ours = signal(paths, np.ones(panel.shape, np.float32))[0] / signal.free[0]

            def own():
                gvxr.resetBeamSpectrum()
                for energy, count in zip(energies, photons):
                    gvxr.addEnergyBinToSpectrumPerPixelAtSDD(energy, "keV", count)
                gvxr.removePolygonMeshesFromSceneGraph()
                for name in names:
                    mesh = meshes[name]
                    gvxr.makeTriangularMesh(
                        name, mesh.vertices.ravel().tolist(), mesh.faces.ravel().tolist(), "mm"
                    )
                    shares = material(name).mass_fractions
                    gvxr.setMixture(name, list(shares), list(shares.values()))
                    gvxr.setDensity(name, material(name).density_g_cm3, "g/cm3")
                    gvxr.addPolygonMeshAsInnerSurface(name)
                image = np.empty(panel.shape, np.float32)
                gvxr.computeXRayImage(image, True)
                return image / np.float32(image.max())

            theirs = GVXR.engine._call(own)
        assert theirs.min() < 0.1, theirs.min()
        print(names, np.abs(ours - theirs).max())
        assert np.abs(ours - theirs).max() < 1e-5
    """
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
        check=False,
    )
    assert result.returncode == 0, result.stderr[-2000:]
    figure(result.stdout)
