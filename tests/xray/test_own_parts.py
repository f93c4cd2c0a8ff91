"""Parts of other packages: cast by their own rays, beside the meshes that an engine renders."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import trimesh
from xray_scenes import body, front_view, random_pose, random_view, sphere

from twinct.core.errors import SpecimenError
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.geometry.bodies import Voxels, sampled
from twinct.scenario import Detector, Source
from twinct.specimen import BuiltPart, BuiltSpecimen
from twinct.specimen.materials import material
from twinct.specimen.own_parts import SolidPart, own_part
from twinct.specimen.part_kinds import PartKind, PartSettings
from twinct.xray import Imager
from twinct.xray.paths import PathRenderer

PANEL = Panel(60, 80, 3.0, 2.5)
AXES = 30.0, 30.0, 18.0
FLAT_MM = 0.15
"""Largest difference of a path length by 20,480 triangles from that of the ellipsoid."""
WATER, TITANIUM = material("water"), material("titanium")


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Parts of the kinds of ``tests/extension``, or of another kind."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "extension")

    def make(name: str, pose: Pose | None = None, kind: PartKind | None = None, **keys: Any) -> Any:
        if kind is None:
            module = __import__(f"twinct_tiny.{name}", fromlist=[name.upper()])
            kind = getattr(module, name.upper())
        for user in ("own_parts", "shapes"):
            monkeypatch.setattr(f"twinct.specimen.{user}.part_kinds", lambda: {name: kind})
        shape: Any = kind.settings.model_validate({"kind": name, **keys})
        return own_part(shape, name, WATER, pose or Pose.identity())

    return make


def egg(made: Callable[..., Any], pose: Pose | None = None) -> SolidPart:
    return made("egg", pose, radius_mm=AXES[0], height_mm=AXES[2])


def as_mesh(pose: Pose) -> BuiltPart:
    ball = trimesh.creation.icosphere(subdivisions=5)
    ball.vertices = pose.apply(ball.vertices * AXES)
    return body(ball, WATER)


@pytest.mark.parametrize("engine", ["gvxr", "mesh"])
def test_a_solid_and_a_mesh_beside_it_have_their_path_lengths(made, engine: str, figure) -> None:
    rng = np.random.default_rng(3)
    ball = body(sphere([42, 0, 0], 10.0), TITANIUM)
    longest = worst = 0.0
    for _ in range(4):
        pose, place = random_pose(rng, 5.0), random_pose(rng, 5.0)
        view = random_view(rng, PANEL, np.zeros(3))
        with PathRenderer([egg(made, pose), ball], PANEL, 2, engine=engine) as renderer:
            assert [one.name for one in renderer.materials] == ["titanium", "water"]
            mine = renderer.render(view, place)
        with PathRenderer([as_mesh(pose), ball], PANEL, 2, engine="mesh") as renderer:
            theirs = renderer.render(view, place)
        assert np.abs(mine[0] - theirs[1]).mean() < 0.02
        inner = theirs[0] > 20
        worst = max(worst, float(np.abs(mine[1] - theirs[0])[inner].max(initial=0.0)))
        longest = max(longest, float(theirs[0].max()))
        assert np.abs(mine[1] - theirs[0]).mean() < 0.01
    figure(f"ellipsoid by formulas against its mesh: worst path {worst:.3f} mm")
    assert longest > 40
    assert worst < FLAT_MM


def test_an_ideal_image_has_all_parts_once(made) -> None:
    solid, ball = egg(made), body(sphere([42, 0, 0], 10.0), TITANIUM)
    detector = Detector(columns=80, rows=60, pixel_pitch_mm=(2.5, 3.0))
    view, images = front_view(detector.panel), []
    place = Pose.from_euler((0.0, 0.0, 0.0), (0.0, 0.0, 90.0))
    for parts in ((solid, ball), (solid,), (ball,)):
        built = BuiltSpecimen(parts, Pose.identity())
        with Imager(Source(), detector, built, engine="mesh") as imager:
            images.append(imager.render(view, place))
    assert images[1].min() < 0.6 and images[2].min() < 0.6
    np.testing.assert_allclose(images[0], images[1] * images[2], rtol=1e-6)


def test_a_solid_has_its_truth_and_its_hull_at_its_place(made) -> None:
    pose, place = (
        random_pose(np.random.default_rng(7), 20.0),
        random_pose(np.random.default_rng(8), 20.0),
    )
    built = BuiltSpecimen((egg(made, pose),), place)
    grid = VolumeGrid((50, 60, 70), (2.0, 2.2, 2.4), random_pose(np.random.default_rng(9), 5.0))
    mu = WATER.mu_per_mm(70.0)
    mine = built.truth(grid, 70.0)
    theirs = BuiltSpecimen((as_mesh(pose),), place).truth(grid, 70.0)
    volume = mine.sum() / mu * np.prod(grid.voxel)
    assert volume == pytest.approx(4 / 3 * np.pi * np.prod(AXES), rel=2e-3)
    assert np.abs(mine - theirs).max() < 0.2 * mu
    assert np.ptp(built.hull.vertices @ pose.rotation[:, 2]) == pytest.approx(2 * AXES[2], rel=0.01)
    assert built.pure == built.parts and not built.mixtures


def test_voxels_are_grey_parts_with_a_skin(made) -> None:
    pose = Pose.from_euler((5.0, 0.0, 0.0), (0.0, 0.0, 30.0))
    part = made("foam", pose, radius_mm=20.0)
    assert [one.name for one in part.materials] == ["water", "bone"] and not part.homogeneous
    low, high = part.mesh.bounds
    np.testing.assert_allclose((low + high) / 2, [5, 0, 0], atol=0.1)
    assert 25 < (high - low).min() < (high - low).max() < 42
    assert not part.field.amounts[0].any() and not part.field.amounts[:, :, -1].any()


class Odd(PartSettings):
    """Whatever a test wants."""

    kind: Literal["odd"]


@pytest.mark.parametrize(
    ("amounts", "reason"),
    [
        (np.ones((3, 4, 6)), r"amounts are \(3, 4, 6\); its grid has \(3, 4, 5\) voxels"),
        (np.full((3, 4, 5), np.nan), "must be finite, and some above 0"),
        (np.zeros((3, 4, 5)), "must be finite, and some above 0"),
        ({"watr": np.ones((3, 4, 5))}, "part 'odd' of kind odd.*watr"),
    ],
)
def test_voxels_that_make_no_body_are_refused(made, amounts, reason: str) -> None:
    kind = PartKind(Odd, voxels=lambda _: Voxels(amounts, VolumeGrid((3, 4, 5), 2.0)))
    with pytest.raises(SpecimenError, match=reason):
        made("odd", kind=kind)


@pytest.mark.parametrize("lengths", [np.ones(3), -1.0, np.nan])
def test_path_lengths_that_cannot_be_are_refused(made, lengths) -> None:
    class Wrong:
        def path_lengths(self, source: Any, ends: Any) -> Any:
            return np.broadcast_to(lengths, ends.shape[:-1] if np.ndim(lengths) == 0 else (3,))

        def fractions(self, grid: VolumeGrid) -> Any:
            return sampled(lambda points: points[..., 0] > 0, grid)

        def surface(self) -> Any:
            ball = sphere([0, 0, 0], 10.0)
            return ball.vertices, ball.faces

    part = made("odd", kind=PartKind(Odd, solid=lambda _: Wrong()))
    view = random_view(np.random.default_rng(1), PANEL, np.zeros(3))
    with PathRenderer([part], PANEL, engine="none") as renderer:
        with pytest.raises(SpecimenError, match="of kind odd: path_lengths returned"):
            renderer.render(view, Pose.identity())


def test_a_kind_says_in_one_way_what_it_is() -> None:
    for given in ({}, {"voxels": lambda _: None, "solid": lambda _: None}):
        with pytest.raises(ValueError, match="needs one of surface, voxels and solid"):
            PartKind(Odd, **given)
