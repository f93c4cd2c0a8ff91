"""Images of grey parts, alone and beside meshes: by hand, and through the whole detector chain."""

import numpy as np
import pytest
from posed import posed
from scipy.spatial.transform import Rotation
from xray_scenes import box, sphere

from twinct.core.errors import TwinctError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.scenario import Detector, FileSpectrum, GaussianSpot, IntegratingResponse, Source
from twinct.specimen import BuiltPart, BuiltSpecimen, GreyField, GreyPart
from twinct.specimen.materials import material
from twinct.xray import Imager
from twinct.xray.paths import PathRenderer

PANEL = Panel(24, 32, 6.0, 6.0)
DETECTOR = Detector(columns=32, rows=24, pixel_pitch_mm=6.0)
NAMES = "water", "bone", "titanium"
NO_ENGINE = "none is needed"


def view(source_mm: float = 400.0, panel: Panel = PANEL) -> ScanGeometry:
    """Source on -z, panel on +z, seen straight."""
    return ScanGeometry([[0, 0, -source_mm]], [[0, 0, 300]], [[1, 0, 0]], [[0, -1, 0]], panel)


def grey(amounts: np.ndarray, voxel, pose: Pose | None = None, names=NAMES) -> GreyPart:
    """A grey part whose skin is the box around its grid."""
    materials = tuple(material(name) for name in names)
    grid = VolumeGrid(amounts.shape[:3], voxel, pose)
    field = GreyField(materials, np.asarray(amounts, np.float32), grid)
    skin = box([0, 0, 0], grid.size_mm)
    skin.apply_transform(grid.world_from_grid.matrix)
    return GreyPart("patient", material("bone"), skin, field)


def slab(pose: Pose | None = None) -> tuple[GreyPart, np.ndarray]:
    """A wide slab of layers across z, 48 mm thick, and the mean amount of each material."""
    layers = np.random.default_rng(0).uniform(0, [1.0, 0.3, 0.02], (12, 3))
    amounts = np.broadcast_to(layers[:, None, None], (12, 40, 40, 3))
    return grey(amounts, (8.0, 8.0, 4.0), pose), layers.mean(axis=0)


def specimen(*parts: BuiltPart | GreyPart) -> BuiltSpecimen:
    return BuiltSpecimen(parts, Pose.identity())


def part(mesh, name="titanium") -> BuiltPart:
    return BuiltPart(name, material(name), mesh)


@pytest.mark.parametrize("tilt_deg", [0, 12, 30])
def test_transmission_of_slabs_is_the_sum_over_energies(tilt_deg, tmp_path, figure):
    energies = np.arange(25.0, 121.0, 2.5)
    photons = np.exp(-(((energies - 60) / 25) ** 2))
    np.savetxt(tmp_path / "tube.csv", np.stack([energies, photons], 1), delimiter=",")
    spectrum = FileSpectrum(kind="file", path=tmp_path / "tube.csv")
    turn = Rotation.from_euler("x", tilt_deg, degrees=True).as_quat()
    pose = Pose(np.array([0.0, 0.0, 20.0]), turn)
    body, amounts = slab(pose)
    detector = DETECTOR.model_copy(update={"response": IntegratingResponse(kind="integrating")})
    seen = view()
    with Imager(Source(spectrum=spectrum), detector, specimen(body), engine=NO_ENGINE) as imager:
        image = imager.render(seen, Pose.identity())
    rays = seen.pixel_centres(0) - seen.source[0]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    lengths = 48.0 / np.abs(rays @ pose.rotation[:, 2])
    mus = np.array([[m.mu_per_mm(e) for m in body.field.materials] for e in energies])
    weights = photons * energies / (photons @ energies)
    expected = np.exp(-np.multiply.outer(lengths, mus @ amounts)) @ weights
    error = np.abs(image - expected).max()
    figure(f"transmission of grey slabs against the sum over energies: worst pixel {error:.1e}")
    assert 0.1 < expected.mean() < 0.5
    assert error < 1e-5


def test_monochromatic_transmission_of_an_ideal_detector():
    body, amounts = slab()
    with Imager(Source(energy_kev=70.0), DETECTOR, specimen(body), engine=NO_ENGINE) as imager:
        image = imager.render(view(), Pose.identity())
    away = view().pixel_centres(0) - view().source[0]
    lengths = 48.0 * np.linalg.norm(away, axis=-1) / away[..., 2]
    mu = amounts @ [m.mu_per_mm(70.0) for m in body.field.materials]
    np.testing.assert_allclose(image, np.exp(-mu * lengths), rtol=2e-5)


def mixed() -> tuple[BuiltSpecimen, BuiltPart, GreyPart]:
    """A ball of titanium and a grey ball beside it, partly in its shadow."""
    rng = np.random.default_rng(1)
    x, y, z = np.meshgrid(*[np.arange(-19.5, 20)] * 3, indexing="ij")
    inside = (x**2 + y**2 + z**2 < 15**2)[..., None]
    pose = Pose(np.array([10.0, 5.0, 30.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    body = grey(inside * rng.uniform(0, [1.0, 0.5, 0.01], (40, 40, 40, 3)), 2.0, pose)
    ball = part(sphere([-10, 0, -40], 12.0))
    return specimen(ball, body), ball, body


@pytest.mark.parametrize("engine", ["gvxr", "mesh"])
def test_meshes_and_voxels_add_up_in_an_ideal_image(engine):
    both, ball, body = mixed()
    pose = Pose(np.array([3.0, -2.0, 1.0]), Rotation.from_euler("y", 10, degrees=True).as_quat())
    images = []
    for parts in (both, specimen(ball), specimen(body)):
        with Imager(Source(energy_kev=70.0), DETECTOR, parts, engine=engine) as imager:
            images.append(imager.render(view(), pose))
    product = images[1] * images[2]
    assert (product < 0.95 * np.minimum(images[1], images[2])).any()
    np.testing.assert_allclose(images[0], product, rtol=1e-6)


@pytest.mark.parametrize("engine", ["gvxr", "mesh"])
def test_meshes_and_voxels_add_up_in_path_lengths(engine):
    _, ball, body = mixed()
    one, two = Pose.identity(), Pose(np.array([4.0, 3.0, 2.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    with PathRenderer([ball, body], PANEL, 2, engine=engine) as renderer:
        assert [m.name for m in renderer.materials] == ["titanium", "water", "bone"]
        paths = renderer.render(view(), [one, two])
    with PathRenderer([ball], PANEL, 2, engine=engine) as renderer:
        of_ball = renderer.render(view(), one)[0]
    with PathRenderer([body], PANEL, 2, engine=NO_ENGINE) as renderer:
        of_body = renderer.render(view(), two)
    assert paths.shape == (3, 48, 64)
    np.testing.assert_array_equal(paths[0], of_ball + of_body[2])
    np.testing.assert_array_equal(paths[1:], of_body[:2])


def test_whole_chain_takes_grey_parts(tmp_path):
    """Several samples a pixel, a focal spot and an exposure in motion: means of single images."""
    both, _, _ = mixed()
    source = Source(
        energy_kev=70.0, focal_spot=GaussianSpot(kind="gaussian", sigma_mm=2, samples=2)
    )
    detector = DETECTOR.model_copy(update={"pixel_samples": 3})
    moved = Pose(np.array([6.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    instants = posed(ScanGeometry.joined([view(), view()]), Pose.identity(), moved)
    with Imager(source, detector, both, engine="mesh") as imager:
        spread = imager.expose(instants)
        single = [imager.expose(instants[k : k + 1]) for k in range(2)]
    np.testing.assert_allclose(spread, np.mean(single, axis=0), atol=2e-6)
    with Imager(Source(energy_kev=70.0), DETECTOR, both, engine="mesh") as imager:
        sharp = imager.expose(instants[:1])
    assert 1e-3 < np.abs(single[0] - sharp).mean() < 2e-2


def test_source_and_panel_stay_outside_the_skin():
    _, _, body = mixed()
    with Imager(Source(), DETECTOR, specimen(body), engine=NO_ENGINE) as imager:
        with pytest.raises(TwinctError, match="source is inside part 'patient'"):
            imager.render(view(-30.0), Pose.identity())
        through = Pose(np.array([0.0, 0.0, 280.0]), np.array([0.0, 0.0, 0.0, 1.0]))
        with pytest.raises(TwinctError, match="part 'patient' of the specimen reaches through"):
            imager.render(view(), through)


def test_several_imagers_of_grey_parts_are_open_beside_one_of_meshes():
    both, _, body = mixed()
    with (
        Imager(Source(), DETECTOR, both, engine="mesh"),
        Imager(Source(), DETECTOR, specimen(body), engine=NO_ENGINE) as one,
        Imager(Source(), DETECTOR, specimen(body), engine=NO_ENGINE) as other,
    ):
        images = [imager.render(view(), Pose.identity()) for imager in (one, other)]
    assert images[0].min() < 0.9
    np.testing.assert_array_equal(*images)
