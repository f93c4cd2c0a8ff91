"""Objects of the room attenuate the beam as their thickness tells, whatever the engine."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from xray_scenes import box, sphere

from twinct.geometry import Floats, Panel, Pose, ScanGeometry, VolumeGrid
from twinct.scenario import Detector, GaussianSpot, RoomObject, Source
from twinct.specimen import BuiltPart, BuiltSpecimen, GreyField, GreyPart
from twinct.specimen.materials import material
from twinct.specimen.room_bodies import beam_bodies
from twinct.specimen.sections.room_objects import keyed
from twinct.xray import Imager

PANEL = Panel(24, 32, 6.0, 6.0)
DETECTOR = Detector(columns=32, rows=24, pixel_pitch_mm=6.0)
CARBON = {"mass_fractions": {"C": 1.0}, "density_g_cm3": 1.6}
TILT_DEG = 25.0


def view(pose: Pose | None = None) -> ScanGeometry:
    seen = ScanGeometry([[0, 0, -400]], [[0, 0, 300]], [[1, 0, 0]], [[0, -1, 0]], PANEL)
    return (pose or Pose.identity()) @ seen


def plate(**more: object) -> RoomObject:
    shape = {"kind": "box", "size_mm": [3000, 3000, 4]}
    data = {"name": "plate", "shape": shape, "material": CARBON, **more}
    return RoomObject.model_validate(data)


def solid() -> BuiltSpecimen:
    ball = BuiltPart("ball", material("water"), sphere([0, 0, 0], 30))
    return BuiltSpecimen((ball,), Pose.identity())


def grey() -> BuiltSpecimen:
    field = GreyField(
        (material("water"),), np.ones((8, 8, 8, 1), np.float32), VolumeGrid((8, 8, 8), 6.0)
    )
    part = GreyPart("patient", material("water"), box([0, 0, 0], (48, 48, 48)), field)
    return BuiltSpecimen((part,), Pose.identity())


def rays(seen: ScanGeometry) -> Floats:
    """Unit vectors from the source to each pixel, (rows, columns, 3)."""
    ways = seen.pixel_centres(0) - seen.source[0]
    return ways / np.linalg.norm(ways, axis=-1, keepdims=True)


def shot(specimen: BuiltSpecimen, objects: list[RoomObject], engine: str, **more) -> Floats:
    chain = more.pop("chain", False)
    source = Source(focal_spot=GaussianSpot(kind="gaussian", sigma_mm=0.3)) if chain else Source()
    bodies = beam_bodies(keyed(objects))
    with Imager(source, DETECTOR, specimen, engine=engine, objects=bodies) as imager:
        return imager.render(more.get("seen", view()), more.get("place", Pose.identity()))


@pytest.mark.parametrize("chain", [False, True])
@pytest.mark.parametrize(
    ("make", "engine"), [(solid, "gvxr"), (solid, "mesh"), (grey, "none is needed")]
)
def test_a_carbon_plate_attenuates_by_its_thickness(make, engine: str, chain: bool) -> None:
    tilted = plate(position_mm=[0, 0, 120], rotation_deg=[TILT_DEG, 0, 0])
    alone = shot(make(), [], engine, chain=chain)
    behind = shot(make(), [tilted], engine, chain=chain)
    normal = Rotation.from_euler("x", TILT_DEG, degrees=True).apply([0, 0, 1])
    mu = material(tilted.material or "").mu_per_mm(Source().energy_kev)
    expected = np.exp(-mu * 4.0 / np.abs(rays(view()) @ normal))
    assert behind / alone == pytest.approx(expected, rel=2e-5)
    assert expected.max() < 0.9


def test_an_object_stands_still_while_the_patient_moves() -> None:
    moved = Pose(np.array([200.0, 0, 0]), Pose.identity().quat)
    standing = plate(shape={"kind": "sphere", "radius_mm": 20})
    still = shot(solid(), [standing], "mesh", place=moved)
    free = shot(solid(), [], "mesh", place=moved)
    assert (still / free).min() == pytest.approx(
        np.exp(-40 * material(CARBON_SECTION).mu_per_mm(80.0)), rel=0.02
    )


CARBON_SECTION = plate().material or ""


def test_a_ray_counts_from_the_source_to_its_pixel_only() -> None:
    """Of a plate along the beam, which begins behind the source and ends behind the panel."""
    shape = {"kind": "box", "size_mm": [40, 3000, 3000]}
    beside = shot(solid(), [plate(shape=shape, position_mm=[-80, 0, 0])], "mesh")
    free = shot(solid(), [], "mesh")
    # By hand: the part of each ray, 0 at the source and 1 at its pixel, between two planes.
    x = view().pixel_centres(0)[..., 0]
    with np.errstate(divide="ignore"):
        enter, leave = np.sort([-100 / x, -60 / x], axis=0)
    share = np.clip(leave, 0, 1) - np.clip(enter, 0, 1)
    share[x >= 0] = 0
    far = np.linalg.norm(view().pixel_centres(0) - view().source[0], axis=-1)
    mu = material(CARBON_SECTION).mu_per_mm(80.0)
    assert beside / free == pytest.approx(np.exp(-mu * share * far), rel=2e-5)
    assert share.max() > 0.1


def test_of_two_objects_that_overlap_the_later_one_counts() -> None:
    lead = plate(name="lead", material="lead", shape={"kind": "sphere", "radius_mm": 30})
    water = plate(name="water", material="water", shape={"kind": "sphere", "radius_mm": 60})
    over = shot(solid(), [lead, water], "mesh")
    assert over == pytest.approx(shot(solid(), [water], "mesh"), abs=1e-6)
