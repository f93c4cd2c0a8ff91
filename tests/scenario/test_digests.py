"""Stage digests: which keys make what anew, and what leaves everything as it is."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from twinct.core.settings import FILE_KEYS, annotation_of, is_file, models_in
from twinct.robots.arm_files import ArmFile
from twinct.robots.sections.cell import known_arms
from twinct.scenario import Scenario, Source, load_scenario, parse_scenario, stage_digests
from twinct.scenario.digests import STAGES, declared, readers

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"

IMAGED = {"images", "volume"}
MOVED = {"executed", "images", "believed", "volume"}
PLANNED = MOVED | {"plan"}
ALL = PLANNED | {"surface"}
BLUR = "source.motion_samples=2"
QUANTUM = ["detector.noise={kind: quantum}", "source.photons_per_mm2_mas=1e5"]
EXACT = ["uncertainty.source.sigma_mm=0", "uncertainty.detector.sigma_mm=0"]


def digests(*overrides: str) -> dict[str, str]:
    return dict(stage_digests(load_scenario(DEMO, overrides)))


def changed(one: dict[str, str], other: dict[str, str]) -> set[str]:
    return {stage for stage in one if one[stage] != other[stage]}


@pytest.mark.parametrize(
    ("override", "stages"),
    [
        ("name=other", set()),
        ("description=other", set()),
        ("specimen.parts.0.name=other", set()),
        ("specimen.parts.0.shape.scale=1.1", ALL),
        ("specimen.parts.0.rotation_deg=[0, 0, 9]", ALL),
        ("specimen.parts.0.material=water", IMAGED),
        ("specimen.reference=skull", {"volume"}),
        ("specimen.rotation_deg=[0, 0, 9]", PLANNED),
        ("trajectory.views=99", PLANNED),
        ("detector.columns=320", PLANNED),
        ("cell.table.present=false", PLANNED),
        ("cell.source_arm.model=lbr_iiwa14", PLANNED),
        ("motion.ik.max_iterations=300", PLANNED),
        ("motion.clearance_mm=11", PLANNED),
        ("motion.trigger=settled", MOVED),
        ("cell.detector_arm.tool_mass_kg=5", MOVED),
        ("cell.timestep_ms=1", MOVED),
        (BLUR, MOVED),
        ("source.energy_kev=70", IMAGED),
        ("source.exposure_ms=20", MOVED),
        ("detector.response={kind: counting}", IMAGED),
        ("detector.readout={}", IMAGED),
        ("detector.lag=0.1", IMAGED),
        ("xray.engine=gvxr", set()),
        ("xray.engine=another", IMAGED),
        ("xray.engine=mesh", IMAGED),
        ("seed=5", {"believed", "volume"}),
        ("uncertainty.seed=5", {"believed", "volume"}),
        ("uncertainty.source.sigma_mm=0.05", {"believed", "volume"}),
        ("uncertainty.source.rotation_sigma_deg=0.1", {"believed", "volume"}),
        ("uncertainty.encoder_step_deg=0.01", {"believed", "volume"}),
        ("uncertainty.arms.tool_mm=0.2", MOVED),
        ("uncertainty.views.source_mm=0.2", MOVED),
        ("uncertainty.patient.nod_mm=2", MOVED),
        ("uncertainty.preset=collaborative", MOVED),
        ("uncertainty.arms.seed=3", set()),
        ("reconstruction.iterations=3", {"volume"}),
        ("reconstruction.algorithm=sirt", {"volume"}),
        ("reconstruction.geometry=executed", {"volume"}),
        ("reconstruction.beam_hardening=null", set()),
        ("evaluation={regions: [{name: a, shape: {kind: sphere, radius_mm: 5}}]}", set()),
        ("task={views: 5, completeness: {}}", set()),
        ("reconstruction.metal=null", set()),
        ("reconstruction.zoom=null", set()),
        ("reconstruction.zoom={size_mm: 9, voxel_mm: 1}", {"volume"}),
        ("reconstruction.metal={method: nmar}", {"volume"}),
    ],
)
def test_a_key_makes_anew_what_depends_on_it(override: str, stages: set[str]) -> None:
    assert changed(digests(), digests(override)) == stages


@pytest.mark.parametrize(
    ("base", "override", "stages"),
    [
        ([BLUR], "source.exposure_ms=20", MOVED),
        (QUANTUM, "seed=5", {"images", "believed", "volume"}),
        (QUANTUM, "uncertainty.seed=5", {"believed", "volume"}),
        ([*QUANTUM, "uncertainty.seed=5"], "seed=5", IMAGED),
        ([*EXACT, "detector.bad_pixels={kind: random, share: 0.1}"], "seed=5", IMAGED),
        ([*EXACT, "detector.readout={electronic_noise: 2}"], "seed=5", IMAGED),
        ([*EXACT, "detector.readout={}"], "seed=5", set()),
        (["uncertainty.arms.tool_mm=0.2"], "seed=5", MOVED),
        (["uncertainty.arms.tool_mm=0.2"], "uncertainty.arms.seed=5", MOVED),
        (["uncertainty.arms.tool_mm=0.2"], "uncertainty.seed=5", {"believed", "volume"}),
        ([*EXACT, "reconstruction.order=random"], "seed=5", {"volume"}),
        ([*EXACT, "reconstruction.order=golden"], "seed=5", set()),
        ([*EXACT, "reconstruction.order=golden"], "uncertainty.seed=5", set()),
    ],
)
def test_a_key_counts_where_it_is_read(base: list[str], override: str, stages: set[str]) -> None:
    assert changed(digests(*base), digests(*base, override)) == stages


def test_poses_that_the_volume_does_not_use_do_not_change_it() -> None:
    base = "reconstruction.geometry=[executed, commanded]"
    assert changed(digests(base), digests(base, "uncertainty.seed=3")) == {"believed"}


def test_ten_seeds_of_the_believed_poses_are_one_set_of_images() -> None:
    all_of_them = [digests(f"seed={seed}") for seed in range(10)]
    assert len({found["images"] for found in all_of_them}) == 1
    assert len({found["believed"] for found in all_of_them}) == 10
    # The same seed, whoever gives it, is the same noise.
    assert changed(digests("seed=4"), digests("seed=8", "uncertainty.seed=4")) == set()


def test_defaults_that_are_written_out_change_nothing() -> None:
    scenario = load_scenario(DEMO)
    explicit = parse_scenario(json.loads(scenario.resolved()))
    assert explicit.motion.model_fields_set > scenario.motion.model_fields_set
    assert stage_digests(explicit) == stage_digests(scenario)


def test_a_later_key_at_its_default_changes_nothing() -> None:
    class Later(Source):
        anode_heel: float = 0.0

    def of(section: Source) -> dict[str, str]:
        return dict(stage_digests(scenario.model_copy(update={"source": section})))

    scenario = load_scenario(DEMO)
    now = of(Source(energy_kev=70))
    assert of(Later(energy_kev=70)) == now
    assert changed(of(Later(energy_kev=70, anode_heel=1)), now) == IMAGED


def test_a_raised_version_makes_its_stage_and_all_above_anew(monkeypatch) -> None:
    import dataclasses

    before = digests()
    raised = dataclasses.replace(STAGES["executed"], version=99)
    monkeypatch.setitem(STAGES, "executed", raised)
    assert changed(before, digests()) == MOVED


def test_files_count_by_their_content(tmp_path: Path) -> None:
    def mesh(file: Path) -> dict[str, str]:
        return digests(f"specimen.parts.0.shape={{kind: mesh, path: {file}}}")

    one, other = tmp_path / "a.stl", tmp_path / "b.stl"
    one.write_text("1")
    other.write_text("1")
    first = mesh(one)
    assert mesh(other) == first
    other.write_text("2")
    assert changed(mesh(other), first) == ALL


def test_a_store_outlives_the_files_of_its_scenario(tmp_path: Path) -> None:
    file = tmp_path / "a.stl"
    file.write_text("1")
    scenario = load_scenario(DEMO, [f"specimen.parts.0.shape={{kind: mesh, path: {file}}}"])
    before = dict(stage_digests(scenario))
    file.unlink()
    assert changed(dict(stage_digests(scenario)), before) == ALL


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Every key that holds a value, dotted, of all sections that could stand there."""
    for name, info in model.model_fields.items():
        inner = models_in(annotation_of(info))
        for section in inner:
            yield from keys(section, f"{prefix}{name}.")
        if not inner:
            yield f"{prefix}{name}"


COUNT_FOR_NONE = (
    *("name", "description", "specimen.parts.name", "evaluation", "uncertainty.preset"),
    *("task", "cell.objects.name", "cell.objects.colour"),
)
"""Keys and sections that affect neither scan nor truth nor volume."""


def test_every_key_is_read_by_a_stage_or_counts_for_none() -> None:
    everything = set(keys(Scenario))
    assert "specimen.parts.shape.radius_mm" in everything
    for_none = {
        key for key in everything if any(f"{key}.".startswith(f"{one}.") for one in COUNT_FOR_NONE)
    }
    assert not {key for key in everything if not readers(key)} - for_none
    assert not {key for key in for_none if readers(key)}
    assert all(any(f"{key}.".startswith(f"{one}.") for key in for_none) for one in COUNT_FOR_NONE)


def test_keys_of_files_have_the_names_by_which_paths_are_made_absolute() -> None:
    def names(model: type[BaseModel]) -> Iterator[str]:
        for name, info in model.model_fields.items():
            if is_file(info):
                yield name
            for section in models_in(annotation_of(info)):
                yield from names(section)

    assert set(names(Scenario)) == set(FILE_KEYS)


def test_the_file_of_an_arm_of_another_package_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "arm.xml"
    monkeypatch.setitem(known_arms(), "mine", ArmFile("mine", file))
    file.write_text("1")
    one = digests("cell.source_arm.model=mine")
    file.write_text("2")
    assert changed(digests("cell.source_arm.model=mine"), one) == PLANNED


def test_calibrated_arms_count_by_their_content(tmp_path: Path) -> None:
    file = tmp_path / "arms.json"
    file.write_text("1")
    one = digests(f"uncertainty.calibration={file}")
    file.write_text("2")
    assert changed(digests(f"uncertainty.calibration={file}"), one) == {"believed", "volume"}


def test_every_reader_that_a_key_declares_is_a_stage() -> None:
    named = {stage for _, stages in declared(Scenario) for stage in stages}
    assert named == set(STAGES)


def test_volumes_of_scans_with_noise_have_another_version(monkeypatch) -> None:
    """Photons count for them since the version was raised; others keep their digests."""
    noisy = ["detector.noise={kind: snr, snr: 100}"]
    plain, before = digests(), digests(*noisy)
    monkeypatch.setattr("twinct.scenario.digests._SINCE_PHOTONS", 99)
    assert digests() == plain
    assert changed(before, digests(*noisy)) == {"volume"}
