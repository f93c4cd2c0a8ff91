"""Scenario files: extends, overrides, and one clear message a problem."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import pytest
import yaml

from twinct.core.errors import ScenarioError
from twinct.scenario import load_scenario, parse_scenario, scenario_schema

SCENARIOS = Path(__file__).parents[1] / "scenarios"
DEMO = SCENARIOS / "demo.yaml"


def problems(*overrides: str, path: Path = DEMO) -> str:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path, overrides)
    return "\n".join(caught.value.problems)


def test_paper_is_the_experiment_to_the_letter() -> None:
    scenario = load_scenario(SCENARIOS / "paper.yaml")
    assert scenario.source.energy_kev == 80
    assert (scenario.detector.columns, scenario.detector.rows) == (640, 480)
    assert scenario.detector.pixel_pitch_mm == 0.5
    assert (scenario.trajectory.kind, scenario.trajectory.views) == ("sinusoid", 399)
    assert (scenario.trajectory.sod_mm, scenario.trajectory.sdd_mm) == (300, 600)
    assert scenario.motion.ik.position_tolerance_mm == 0.1
    assert (scenario.motion.trigger, scenario.motion.tolerance_mm) == ("on_entry", 1.0)
    for noise in (scenario.uncertainty.source, scenario.uncertainty.detector):
        assert (noise.sigma_mm, noise.cutoff_mm) == (0.1, 0.15)
    section = scenario.reconstruction
    assert (section.algorithm, section.iterations, section.relaxation) == ("sart", 10, 0.3)
    assert section.grid.volume_grid.shape == (512, 512, 512)
    assert section.grid.voxel_mm == 0.31
    assert section.geometries == ("believed",)


def test_demo_has_the_papers_panel_and_field_of_view() -> None:
    paper, demo = load_scenario(SCENARIOS / "paper.yaml"), load_scenario(DEMO)
    assert demo.detector.panel.size_mm == paper.detector.panel.size_mm
    sizes = [s.reconstruction.grid.volume_grid.size_mm for s in (paper, demo)]
    assert sizes[0] == pytest.approx(sizes[1])
    assert demo.trajectory.views == 100
    assert demo.trajectory.longitude_range_deg == paper.trajectory.longitude_range_deg


def test_overrides_and_their_errors() -> None:
    assert load_scenario(DEMO, ["detector.columns=320"]).detector.columns == 320
    assert load_scenario(DEMO, ["specimen.parts.0.name=me"]).specimen.parts[0].name == "me"
    assert "did you mean 'columns'" in problems("detector.colums=3")
    assert "expected KEY=VALUE" in problems("detector.columns")
    assert "list of length 1; '3'" in problems("specimen.parts.3.name=x")
    assert "--set source.energy_kev=hot" in problems("source.energy_kev=hot")


def test_every_problem_is_one_message() -> None:
    text = problems("detector.pixel_pitch_mm=-1", "trajectory.views=0", "sourse=1")
    assert len(text.splitlines()) == 3
    assert "detector.pixel_pitch_mm: must be greater than 0, but is -1" in text
    assert "trajectory.views: must be at least 1 and at most 100000, but is 0" in text
    assert "did you mean 'source'" in text


def test_numbers_may_be_written_as_scientists_do(tmp_path: Path) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(f"extends: {DEMO}\nreconstruction: {{relaxation: 5e-1}}\n")
    assert load_scenario(file).reconstruction.relaxation == 0.5
    for text, value in (("1e-3", 1e-3), ("1.5e2", 150.0), (".5E+1", 5.0), ("2.e1", 20.0)):
        override = f"motion.tolerance_mm={text}"
        assert load_scenario(DEMO, [override]).motion.tolerance_mm == value
    assert load_scenario(DEMO, ["name=e3"]).name == "e3"


def test_a_problem_of_a_section_names_who_made_it(tmp_path: Path) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(f"extends: {DEMO}\n\ntrajectory: {{sod_mm: 600, sdd_mm: 300}}\n")
    assert problems(path=file).startswith(f"{file}:3: trajectory: sdd_mm (300)")
    text = problems("trajectory.sdd_mm=300")
    assert text.startswith("--set trajectory.sdd_mm=300: trajectory: sdd_mm (300)")
    text = problems("trajectory.kind=corkscrew")
    assert text.startswith("--set trajectory.kind=corkscrew: trajectory.kind: kind 'corkscrew'")
    assert "expected KEY=VALUE" in problems("detector..columns=3")


def test_an_override_opens_a_section_that_is_none() -> None:
    """As in the scenario that a run writes, with all defaults."""
    key = "reconstruction.surroundings"
    keys = [f"{key}=null", f"{key}.margin_mm=50", f"{key}.voxel_mm=5"]
    around = load_scenario(DEMO, keys).reconstruction.surroundings
    assert around is not None and (around.margin_mm, around.voxel_mm) == (50, 5)


def test_another_kind_by_override_starts_afresh_but_for_other_overrides() -> None:
    both = ["trajectory.views=5", "trajectory.kind=circle"]
    for overrides in (both, both[::-1]):
        trajectory = load_scenario(DEMO, overrides).trajectory
        assert (trajectory.kind, trajectory.views) == ("circle", 5)
    text = problems("trajectory.kind=circle")
    assert text == "--set trajectory.kind=circle: trajectory.views: this required key is missing"


def test_problems_are_told_in_plain_words(tmp_path: Path) -> None:
    assert "specimen: parts must have at least 1 entry" in problems("specimen.parts=[]")
    assert "unknown arm 'ur10'; did you mean 'ur10e'?" in problems("cell.source_arm.model=ur10")
    assert "specimen: must be a section of keys and values, but is empty" in problems("specimen=")
    assert "must be a whole number, but is 'many'" in problems("trajectory.views=many")
    file = tmp_path / "x.yaml"
    file.write_text("# nothing yet\n")
    assert problems(path=file) == f"{file}: the scenario is empty"


@pytest.mark.parametrize("depth", [30, 5000])
def test_deep_nesting_is_refused(tmp_path: Path, depth: int) -> None:
    file = tmp_path / "x.yaml"
    file.write_text("a: " + "[" * depth + "]" * depth)
    assert "nested too deep" in problems(path=file)
    assert "specimen" in problems("specimen=" + "[" * depth + "]" * depth)


def test_problems_found_later_get_the_place_of_their_key(tmp_path: Path) -> None:
    from twinct.core.errors import SpecimenError
    from twinct.scenario import named_places

    file = tmp_path / "x.yaml"
    file.write_text(f"extends: {DEMO}\nspecimen:\n  parts:\n    - shape: {{kind: skull}}\n")
    found = ["specimen.parts.0.material: unknown", "part 'skull' is open", "12: odd"]
    with pytest.raises(SpecimenError) as caught, named_places(file, ["specimen.parts.0.name=x"]):
        raise SpecimenError(found)
    first, *others = caught.value.problems
    assert first == f"{file}:4: {found[0]}"  # the override is of another key
    assert others == found[1:]
    with pytest.raises(SpecimenError) as caught, named_places(file, ["specimen.parts.0.shape.x=1"]):
        raise SpecimenError("specimen.parts.0.shape: is odd")
    assert caught.value.problems[0].startswith("--set specimen.parts.0.shape.x=1: ")


def test_nested_problem_is_named_alone() -> None:
    text = problems("specimen.parts.0.shape.scal=2")
    assert text.splitlines()[0].startswith("--set specimen.parts.0.shape.scal=2")
    assert len(text.splitlines()) == 1
    text = problems("specimen.parts.0.material={formula: H2O, densty: 1}")
    assert "did you mean 'density_g_cm3'" in text and "must be a valid string" not in text


def test_another_method_starts_afresh_too(tmp_path: Path) -> None:
    base, file = tmp_path / "b.yaml", tmp_path / "c.yaml"
    base.write_text(f"extends: {DEMO}\nreconstruction: {{metal: {{method: nmar, metal: steel}}}}\n")
    known = "metal: {method: known, implants: [{part: skull}]}"
    file.write_text(f"extends: b.yaml\nreconstruction: {{{known}}}\n")
    key = "reconstruction.metal"
    both = [f"{key}.implants=[{{part: skull}}]", f"{key}.method=known"]
    for path, overrides in ((file, []), (base, both), (base, both[::-1])):
        section = load_scenario(path, overrides).reconstruction.metal
        assert section is not None and section.method == "known"
    assert "metal.method: method 'nmr' is not one of 'nmar', 'known'" in problems(
        f"{key}={{method: nmr}}"
    )
    assert problems(f"{key}={{}}").endswith("this section needs the key 'method'")


def test_another_kind_replaces_the_whole_section(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(
        f"extends: {DEMO}\ntrajectory: {{kind: circle, views: 5}}\n", encoding="utf-8"
    )
    assert load_scenario(tmp_path / "c.yaml").trajectory.kind == "circle"


def test_messages_name_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(f"extends: {DEMO}\n\ndetector:\n  rows: -4\n", encoding="utf-8")
    assert f"{file}:4: detector.rows" in problems(path=file)
    file.write_text("a: 1\na: 2\n", encoding="utf-8")
    assert ":2: the key 'a' appears twice" in problems(path=file)
    file.write_text("a: [1\n", encoding="utf-8")
    assert "not valid YAML" in problems(path=file)
    file.write_text("extends: nowhere.yaml\n", encoding="utf-8")
    assert "no file at" in problems(path=file)
    file.write_text("extends: x.yaml\n", encoding="utf-8")
    assert "extends itself" in problems(path=file)
    assert "the scenario does not exist" in problems(path=tmp_path / "none.yaml")


def test_missing_files_are_named(tmp_path: Path) -> None:
    text = problems(f"specimen.parts.0.shape={{kind: mesh, path: {tmp_path}/a.stl}}")
    assert "specimen.parts.0.shape.path: no file at" in text


def test_paths_are_relative_to_the_file_that_names_them(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "part.stl").write_text("solid")
    (tmp_path / "sub" / "base.yaml").write_text(
        f"extends: {DEMO}\nspecimen: {{parts: [{{shape: {{kind: mesh, path: part.stl}}}}]}}\n"
    )
    (tmp_path / "top.yaml").write_text("extends: sub/base.yaml\n")
    shape = load_scenario(tmp_path / "top.yaml").specimen.parts[0].shape
    assert shape.path == tmp_path / "sub" / "part.stl"


def test_resolved_scenario_reads_back() -> None:
    scenario = load_scenario(DEMO)
    assert parse_scenario(json.loads(scenario.resolved())) == scenario


def test_schema_allows_extends_and_refuses_unknown_keys() -> None:
    schema = scenario_schema()
    assert "extends" in schema["properties"]
    assert schema["additionalProperties"] is False
    assert schema["$defs"]["Detector"]["properties"]["columns"]["description"]


def test_schema_takes_a_part_of_a_section_as_files_that_extend_hold_it() -> None:
    text = json.dumps(schema := scenario_schema())
    assert '"oneOf"' not in text and '"required"' not in text
    choices = schema["properties"]["reconstruction"]["anyOf"]
    assert {"$ref": "#/$defs/FistaTvReconstruction"} in choices
    assert "relaxation" not in schema["$defs"]["CglsReconstruction"]["properties"]
    assert "grid" in schema["$defs"]["CglsReconstruction"]["properties"]


def test_subsets_are_at_most_the_views() -> None:
    text = problems("reconstruction.algorithm=os_sart", "reconstruction.subsets=101")
    assert "subsets (101) must be at most trajectory.views (100)" in text


def test_an_algorithm_in_words_is_its_keys_and_the_corrections() -> None:
    def words(*keys: str) -> str:
        overrides = [TUBE, *(f"reconstruction.{key}" for key in keys)]
        return load_scenario(DEMO, overrides).reconstruction.in_words

    assert words() == "sart, 10 iterations, relaxation 0.3, order golden"
    assert words("algorithm=os_sart", "subsets=4") == (
        "os_sart, 10 iterations, relaxation 0.3, subsets 4"
    )
    assert words("algorithm=fdk", "beam_hardening={kind: one_material}") == (
        "fdk, window ramp, beam hardening of one material"
    )
    assert words("algorithm=fdk", "metal={method: nmar}").endswith(", metal replaced (nmar)")
    known = "metal={method: known, implants: [{part: skull}]}"
    assert words("algorithm=fdk", known).endswith(", 1 known implants removed")


def test_a_key_of_another_algorithm_is_refused_where_its_own_was_chosen(tmp_path: Path) -> None:
    both = ["reconstruction.relaxation=0.5", "reconstruction.algorithm=cgls"]
    for overrides in (both, both[::-1]):
        text = problems(*overrides)
        assert text.startswith(f"--set {both[0]}: reconstruction.relaxation: cgls has no such key")
        assert "sart, os_sart, sirt, rtk_sart have it" in text
        assert len(text.splitlines()) == 1
    assert "sart has no such key, but fdk has it" in problems("reconstruction.window=hann")
    file, later = tmp_path / "fdk.yaml", tmp_path / "later.yaml"
    file.write_text(f"extends: {DEMO}\nreconstruction:\n  algorithm: fdk\n  iterations: 3\n")
    assert problems(path=file).startswith(f"{file}:4: reconstruction.iterations: fdk has no such")
    file.write_text(f"extends: {DEMO}\nreconstruction: {{algorithm: fdk}}\n")
    later.write_text("extends: fdk.yaml\nreconstruction:\n  order: random\n")
    assert problems(path=later).startswith(f"{later}:3: reconstruction.order: fdk has no such key")
    # Neither is the file that chose the same algorithm excused.
    file.write_text(f"extends: {DEMO}\nreconstruction: {{algorithm: sart, window: hann}}\n")
    later.write_text("extends: fdk.yaml\nreconstruction:\n  algorithm: sart\n")
    assert problems(path=later).startswith(f"{file}:2: reconstruction.window: sart has no such key")


def test_another_algorithm_leaves_inherited_keys_it_lacks_and_keeps_the_rest(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    base, file = tmp_path / "base.yaml", tmp_path / "mine.yaml"
    base.write_text(
        f"extends: {DEMO}\nreconstruction:\n  iterations: 7\n  relaxation: 0.5\n"
        "  geometry: executed\n  surroundings: {margin_mm: 9, voxel_mm: 4}\n"
    )
    file.write_text("extends: base.yaml\nreconstruction: {algorithm: cgls}\n")
    by_file = load_scenario(file).reconstruction
    by_override = load_scenario(base, ["reconstruction.algorithm=cgls"]).reconstruction
    said = f"{base}:4: reconstruction.relaxation does not apply to cgls and is ignored"
    assert [record.getMessage() for record in caplog.records] == [said], "once for both"
    load_scenario(base, ["reconstruction.algorithm=fdk"], resolved=True)
    assert len(caplog.records) == 1, "of a run's own file, nobody chose the keys"
    for section in (by_file, by_override):
        assert section.algorithm == "cgls"
        # A number of iterations that somebody chose stays, as all keys that both have.
        assert section.model_dump()["iterations"] == 7
        assert section.geometry == "executed"
        assert section.grid.volume_grid.shape == (128, 128, 128)
        assert section.surroundings is not None and section.surroundings.margin_mm == 9
    assert load_scenario(base, ["reconstruction.algorithm=sart"]).reconstruction == (
        load_scenario(base).reconstruction
    )


def test_unknown_algorithms_and_malformed_sections_are_named() -> None:
    assert "algorithm 'x' is not" in problems("reconstruction={kind: y, algorithm: x}")
    assert "reconstruction: must be a section" in problems("reconstruction=sart")
    assert "has 4" in problems("reconstruction.grid.voxel_mm=[1, 1, 1, 1]")
    text = problems("reconstruction.algorithm=ossart")
    assert text.startswith(
        "--set reconstruction.algorithm=ossart: reconstruction.algorithm: algorithm 'ossart' is "
        "not one of 'sart', 'fast', 'os_sart'"
    )
    assert text.endswith("; did you mean 'os_sart'?")


FLAT = {
    "algorithm": "sart", "engine": "twinct", "iterations": 4, "relaxation": 0.4,
    "order": "random", "subsets": None, "regularisation": 1e-4, "weighting": "uniform",
    "tv_steps": 10, "window": "ramp", "nonnegative": None, "surroundings": None,
    "beam_hardening": None, "geometry": "believed",
    "grid": {
        "voxels": 32, "voxel_mm": 5.0, "centre_mm": [0, 0, 0], "rotation_deg": [0, 0, 0]
    },
}  # fmt: skip
"""What version 0.1 wrote of a reconstruction into its results: every key, with its default."""


@pytest.mark.parametrize(
    ("changes", "today"),
    [
        ({}, {"algorithm": "sart", "iterations": 4, "relaxation": 0.4, "order": "random"}),
        ({"engine": "rtk", "nonnegative": True}, {"algorithm": "rtk_sart", "nonnegative": True}),
        (
            {"algorithm": "fista_tv", "nonnegative": True, "regularisation": 2e-4},
            {"algorithm": "fista_tv", "allow_negative": False, "strength": 2e-4},
        ),
        ({"algorithm": "fdk", "window": "hann"}, {"algorithm": "fdk", "window": "hann"}),
    ],
)
def test_a_scenario_of_version_0_1_is_read(tmp_path: Path, changes, today) -> None:
    data = json.loads(load_scenario(DEMO).resolved()) | {"reconstruction": FLAT | changes}
    file = tmp_path / "scenario.yaml"
    file.write_text(yaml.safe_dump(data))
    for scenario in (parse_scenario(data), load_scenario(file)):
        section = scenario.reconstruction.model_dump()
        assert {key: section[key] for key in today} == today
        assert section["grid"]["voxels"] == 32
    assert "engine" in data["reconstruction"]  # what was given stays as it was


def test_the_kernel_of_scatter_is_refused_with_its_replacement_but_read_in_results(caplog) -> None:
    with pytest.raises(ScenarioError, match=r"detector\.scatter: .*'kernel' is gone.*monte_carlo"):
        load_scenario("demo", ["detector.scatter={kind: kernel}"])
    stored = load_scenario("demo").model_dump(mode="json")
    stored["detector"]["scatter"] = {"kind": "kernel", "scale": 0.3}
    assert parse_scenario(stored).detector.scatter is None
    assert "from a kernel that is gone" in caplog.text


def test_a_scenario_can_be_sent_to_another_process() -> None:
    scenario = load_scenario(DEMO, ["reconstruction.algorithm=fista_tv"])
    assert pickle.loads(pickle.dumps(scenario)) == scenario


def test_plain_data_can_be_overridden() -> None:
    data = json.loads(load_scenario(DEMO).resolved())
    assert load_scenario(data, ["trajectory.views=3"]).trajectory.views == 3
    with pytest.raises(ScenarioError, match="trajectory.views: must be a whole number"):
        load_scenario(data, ["trajectory.views=x"])


TUBE = "source.spectrum={kind: tube, kvp: 90}"


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        (
            ["detector.readout={saturation: 100}"],
            "detector.readout: offset (500) must be below saturation (100)",
        ),
        (
            ["detector.readout={bits: 8, offset: 5}"],
            "detector.readout: the free beam saturates: offset (5) + free_beam (50000) = 50005 "
            "exceeds the largest 8-bit value (255)",
        ),
        (
            ["detector.readout={saturation: 50499}"],
            "= 50500 exceeds saturation (50499)",
        ),
        (
            [TUBE, "reconstruction.beam_hardening={kind: two_materials, base: bone}"],
            "reconstruction.beam_hardening: base and dense are the same material, 'bone'",
        ),
        (
            ["reconstruction.beam_hardening={kind: one_material}"],
            "reconstruction.beam_hardening needs a source.spectrum",
        ),
        (
            ["source.exposure_ms=60001"],
            "source.exposure_ms: must be above 0 and at most 60000, but is 60001",
        ),
        (
            ["source.spectrum={kind: tube, kvp: 51, target: Mo}"],
            "source.spectrum: kvp (51) must be at most 50 with target Mo",
        ),
    ],
)
def test_keys_that_contradict_each_other_are_refused(overrides: list[str], reason: str) -> None:
    text = problems(*overrides)
    assert text.startswith(f"--set {overrides[-1]}: ") and reason in text
    assert len(text.splitlines()) == 1


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("specimen.position_mm", "[0, 0]", "must have 3 entries, but has 2: [0, 0]"),
        (
            "detector.pixel_pitch_mm",
            "0,5",
            "must be a number or a list of 2 entries, but is '0,5'; "
            "numbers have a decimal point: 0.5",
        ),
        (
            "source.spectrum",
            "200kV",
            "must be a mapping of names to values such as {kind: tube} (kinds: tube, file), "
            "but is '200kV'",
        ),
        ("trajectory.views", "0", "must be at least 1 and at most 100000, but is 0"),
    ],
)
def test_a_message_says_what_would_be_allowed(key: str, value: str, said: str) -> None:
    option = f"{key}={value}"
    assert problems(option) == f"--set {option}: {key}: {said}"


@pytest.mark.parametrize(
    "override",
    [
        "detector.readout={bits: null, free_beam: 1e9}",
        "detector.readout={saturation: 50500}",
        "source.spectrum={kind: tube, kvp: 50, target: Rh}",
        "source.exposure_ms=60000",
    ],
)
def test_keys_that_just_fit_are_taken(override: str) -> None:
    load_scenario(DEMO, [override])


def test_a_conflict_of_keys_is_told_where_the_last_of_them_was_set(tmp_path: Path) -> None:
    base, file = tmp_path / "base.yaml", tmp_path / "mine.yaml"
    base.write_text(f"extends: {DEMO}\nsource:\n  spectrum: {{kind: tube, kvp: 90}}\n")
    noise = "detector:\n  rows: 32\n  noise: {kind: quantum}\n"
    file.write_text(f"extends: {DEMO}\nname: x\n{noise}")
    assert problems(path=file).startswith(f"{file}:5: detector.noise of kind 'quantum' needs")
    file.write_text(f"extends: base.yaml\n{noise}\nsource: {{spectrum: null}}\n")
    assert problems(path=file).startswith(f"{file}:6: detector.noise")
    file.write_text(f"extends: base.yaml\n{noise}")
    load_scenario(file)
    override = "source.spectrum=null"
    assert problems(override, path=file).startswith(f"--set {override}: detector.noise")
    # A key set before among those set later is not to blame.
    base.write_text(f"extends: {DEMO}\ntrajectory: {{sod_mm: 500}}\n")
    file.write_text("extends: base.yaml\n\ntrajectory:\n  views: 3\n  sdd_mm: 400\n")
    assert problems(path=file).startswith(f"{file}:5: trajectory: sdd_mm (400)")
    assert problems("trajectory.views=4", path=file).startswith(f"{file}:5: trajectory: sdd_mm")


def test_conflicts_of_several_sections_are_all_told() -> None:
    text = problems(
        "detector.noise={kind: quantum}",
        "reconstruction.beam_hardening={kind: one_material}",
        "reconstruction.algorithm=os_sart",
        "reconstruction.subsets=500",
    )
    assert [line.split(": ", 1)[0] for line in text.splitlines()] == [
        "--set detector.noise={kind",
        "--set reconstruction.subsets=500",
        "--set reconstruction.beam_hardening={kind",
    ]


def test_a_dotted_key_in_a_file_is_named_in_its_own_line(tmp_path: Path) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(f"extends: {DEMO}\n\nsource.spectrum: x\n")
    text = problems(path=file)
    assert text.startswith(f"{file}:3: source.spectrum: unknown key; nest keys in a file")


def test_a_path_that_is_no_utf_8_is_refused_in_our_words() -> None:
    part = {"shape": {"kind": "mesh", "path": "/tmp/\udcff.stl"}}
    with pytest.raises(ScenarioError, match="a path or text is not UTF-8: rename the file"):
        load_scenario({"specimen": {"parts": [part]}})
