"""Everything around a grey part: regions, figures in HU, planning, rays through cuts, export."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from grey_head import SPACING, Truth, grid_of_ct, head, labels, write

from twinct.core.errors import InputError, ScenarioError
from twinct.ctsimu.export import export_scan
from twinct.evaluation import ImageReference
from twinct.geometry import Panel, Pose
from twinct.report import physics_in_words
from twinct.runs.checks import check_sight, findings
from twinct.runs.integrals import hardening_corrected
from twinct.runs.needs import needs
from twinct.runs.on_table import larger_than_table
from twinct.runs.regions import Places
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario
from twinct.specimen.materials import BUILT_IN
from twinct.trajectory import CircleTrajectory, commanded_views
from twinct.view_plans.patient import Patient

KEV = 71.6
Maker = Callable[..., Scenario]


@pytest.fixture
def grey(tiny: Maker, tmp_path: Path) -> Maker:
    """A scenario of the head with its labels, 3 brain and 7 skull."""
    ct, named = write(tmp_path / "head.nii", head()), labels(tmp_path)

    def make(*more: str, shape: str = "", path: Path = ct) -> Scenario:
        names = f"labels: {{path: {named}, names: {{brain: 3, skull: 7}}}}"
        told = f"kind: volume, path: {path}, centre: false, keep: body, {shape or names}"
        part = f"specimen.parts=[{{name: patient, shape: {{{told}}}}}]"
        return tiny(part, "specimen.reference=''", "cell={kind: gantry}", *more)

    return make


def places(scenario: Scenario) -> Places:
    return Places(scenario, SimulationBuilder(scenario).specimen, Pose.identity(), grid_of_ct())


REGIONS = (
    "evaluation={regions: [{name: inside, shape: {kind: part, part: brain}}, "
    "{name: bony, shape: {kind: part, part: skull}}, "
    "{name: around, shape: {kind: shell, part: skull, to_mm: 2}}, "
    "{name: outside, position_mm: [0, 14, 20], shape: {kind: box, size_mm: [30, 8, 8]}}], "
    "hounsfield: [{region: inside}, {region: bony}]}"
)


def test_figures_of_labels_in_hu(grey: Maker) -> None:
    """A volume that is 10 HU too high, with a noise of 5 HU, says so; water calibrates it."""
    at = places(grey(REGIONS))
    assert at.check() == []
    truth = at.specimen.truth(grid_of_ct(), KEV)
    water = BUILT_IN["water"].mu_per_mm(KEV)
    noise = np.random.default_rng(1).normal(10, 5, truth.shape)
    found = at.figures(truth + water * noise / 1000, truth, 0.05, mu_water=water)
    of_brain, of_skull = found["hounsfield"]["inside"], found["hounsfield"]["bony"]
    for name, figures in (("inside", of_brain), ("bony", of_skull)):
        mean = at.region(name).of(truth).mean() / water * 1000 - 1000  # of partly filled voxels
        assert figures["mean_hu"] == pytest.approx(mean + 10, abs=0.7)
    assert of_brain["mean_hu"] < 60 < 800 < of_skull["mean_hu"]
    for one in (of_brain, of_skull):
        assert one["bias_hu"] == pytest.approx(10, abs=0.7)
        assert one["sd_hu"] == pytest.approx(5, rel=0.1)
        assert one["rmse_hu"] == pytest.approx(np.hypot(10, 5), rel=0.1)
    scaled = at.figures(1.1 * truth, truth, 0.05, mu_water=water)
    assert scaled["hounsfield"]["inside"]["bias_hu"] == pytest.approx(100, abs=5)


def test_hu_by_regions_of_water_and_air(grey: Maker) -> None:
    """A scaled and shifted volume is calibrated by its own air and by a region of known HU 0."""
    told = REGIONS.replace("{region: inside}", "{region: inside, water: inside, air: outside}")
    at = places(grey(told))
    truth = at.specimen.truth(grid_of_ct(), KEV)
    found = at.figures(1.3 * truth + 0.01, truth, 0.05, mu_water=0.0196)
    assert found["hounsfield"]["inside"]["mean_hu"] == pytest.approx(0, abs=1e-3)


def test_a_label_is_the_reference(grey: Maker) -> None:
    """Near the reference is near the label, and its mean is 1 for the truth itself."""
    specimen = SimulationBuilder(grey("specimen.reference=skull")).specimen
    grid = grid_of_ct()
    truth, body = specimen.truth(grid, KEV), specimen.reference_voxels(grid, Pose.identity())
    assert body is not None
    mu = specimen.reference_mu(KEV)
    seen = np.ones(grid.shape, dtype=bool)
    reference = ImageReference(truth, seen, mu, grid, body=body)
    assert reference.figures(truth).mean_reference_rel == pytest.approx(1)
    assert reference.figures(1.1 * truth).mean_reference_rel == pytest.approx(1.1)
    assert reference.figures(truth).roi_reference_fraction == pytest.approx(body.mean())
    near = np.asarray(reference.near_reference)
    assert near[14, 20, 27] and near[14, 20, 31] and not near[14, 20, 15]
    soft = SimulationBuilder(grey("specimen.reference=brain")).specimen
    assert soft.reference_mu(KEV) < 0.6 * mu


def test_unknown_labels_are_named_at_once(grey: Maker, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="unknown part or label 'liver'"):
        grey(REGIONS.replace("part: brain", "part: liver"))
    with pytest.raises(ScenarioError, match="no part is called 'liver'"):
        grey("specimen.reference=liver")
    by_file = f"labels: {{path: {tmp_path / 'labels.nii'}}}"
    told = r"evaluation\.regions\.1\.shape\.part: no part or label is called 'skull'"
    with pytest.raises(InputError, match=told):
        places(grey(REGIONS.replace("part: brain", "part: label_3"), shape=by_file)).check()


def test_planning_knows_labels_and_voxels(grey: Maker) -> None:
    patient = Patient(SimulationBuilder(grey()), voxel_mm=2.0)
    volume = patient.attenuation(KEV)
    truth = patient.builder.specimen.truth(volume.grid, KEV)
    assert volume.array == pytest.approx(truth, abs=1e-6)
    points = patient.points_of("skull")
    assert len(points) == 200 and (np.abs(points - [8, 0, 0]) <= [2.6, 4.7, 7.1]).all()
    skull = patient.material_of("skull")
    assert skull.mu_per_mm(KEV) == pytest.approx(2 * BUILT_IN["water"].mu_per_mm(KEV), rel=2e-3)
    assert (
        skull.mass_fractions["Ca"] > 0.1 > patient.material_of("brain").mass_fractions.get("Ca", 0)
    )
    with pytest.raises(InputError, match="'patient' is made of voxels"):
        patient.body("patient")


def test_rays_through_a_cut_are_counted(grey: Maker, tmp_path: Path) -> None:
    """A view along z has all its rays within the body in the cut; views across it have none."""
    whole = head()
    cut = write(tmp_path / "cut.nii", Truth(whole.values[..., 14:], whole.affine.copy()))
    builder = SimulationBuilder(grey(shape="extend_mm: 0", path=cut))
    (part,) = builder.specimen.mixtures
    assert [face.name for face in part.cuts] == ["-z"]
    circle = CircleTrajectory(kind="circle", views=4, sod_mm=600, sdd_mm=900)
    across = commanded_views(circle, Panel(40, 40, 4.0, 4.0))
    along = Pose.from_euler((0, 0, 0), (0, 90, 0)) @ across[:1]
    low = Pose.from_euler((0, 0, 14 * SPACING[2]), (0, 0, 0)) @ across
    # Half of the views' rays pass below the body, where the cone spreads.
    assert part.cut_share(low).max() < 0.02
    box = np.prod(part.field.grid.size_mm[:2])
    area = part.cuts[0].tissue.sum() * np.prod(part.field.grid.voxel[:2])
    assert part.cut_share(along)[0] == pytest.approx(area / box, rel=0.15)
    (told,) = [w for w in check_sight(builder) if "cross the cut" in w]
    assert told.startswith("part 'patient': its CT cuts the body (-z); in 10 views")


def test_words(grey: Maker) -> None:
    builder = SimulationBuilder(grey())
    assert (
        "without scatter"
        in physics_in_words(builder.scenario, *builder.commanded_poses[0])["Detector"]
    )
    told = findings(builder)["specimen"]
    assert told == "patient of voxels of adipose tissue, water and bone"
    with pytest.raises(InputError, match="part 'patient' has grey voxels; CTSimU describes"):
        export_scan(None, builder.specimen, Path("nowhere"))  # type: ignore[arg-type]


def test_hardening_of_the_bulk(grey: Maker) -> None:
    """Line integrals are corrected as those of water, which has most of the mass."""
    keys = (
        "source.spectrum={kind: tube, kvp: 100}",
        "reconstruction.beam_hardening={kind: one_material}",
    )
    integrals = np.full((1, 2, 2), 1.0, np.float32)
    found, water = (
        hardening_corrected(scenario, integrals, None)  # type: ignore[arg-type]
        for scenario in (grey(*keys), grey(keys[0], keys[1].replace("}", ", material: water}")))
    )
    assert found == pytest.approx(water) and not np.allclose(found, integrals)


def test_memory_of_packed_and_plain_files(grey: Maker, tmp_path: Path) -> None:
    """A packed file needs more for each of its bytes, but not more than it unpacks to needs."""
    plain = tmp_path / "head.nii"
    packed = write(tmp_path / "packed.nii.gz", head())
    by_plain, by_packed = (
        needs(grey(shape="surface_hu: -300", path=path))["specimen"].memory_bytes
        for path in (plain, packed)
    )
    ratio = packed.stat().st_size / plain.stat().st_size
    base = by_plain - 10 * plain.stat().st_size
    assert base > 0 and by_packed - base == pytest.approx(3.6 * ratio * (by_plain - base))


def test_a_patient_larger_than_the_table_is_named(grey: Maker) -> None:
    """The head lies on a plate; one that is too short, or elsewhere, is told apart."""
    told = grey().model_dump(mode="json")["specimen"]["parts"][0]
    low, high = SimulationBuilder(grey()).specimen.bounds

    def warned(size: float, drop_mm: float = 0.0) -> list[str]:
        plate = {
            "name": "table",
            "shape": {"kind": "box", "size_mm": [300, size, 4]},
            "material": {"mass_fractions": {"C": 1.0}, "density_g_cm3": 1.6},
            "position_mm": [*((low + high) / 2)[:2].tolist(), float(low[2]) - 2 - drop_mm],
        }
        found = larger_than_table(
            SimulationBuilder(grey(f"specimen.parts={json.dumps([told, plate])}"))
        )
        assert all("part 'patient' is larger than 'table' under it" in one for one in found)
        return found

    (one,) = warned(float(high[1] - low[1]) - 20)
    assert "10 mm at -y, 10 mm at +y beyond it" in one
    assert warned(300) == []
    assert warned(10, drop_mm=60) == []
