"""The section ``evaluation``: what names lead nowhere is told with file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinct.core.errors import ScenarioError
from twinct.scenario import load_scenario

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"

GOOD = f"""\
extends: {DEMO}
specimen:
  parts:
    - {{name: water, shape: {{kind: box, size_mm: [80, 80, 80]}}, material: water}}
    - {{name: ball, shape: {{kind: sphere, radius_mm: 12}}, position_mm: [20, 0, 0]}}
    - {{name: rod, shape: {{kind: cylinder, radius_mm: 4, height_mm: 40}}, material: titanium}}
evaluation:
  regions:
    - {{name: inner, shape: {{kind: sphere, radius_mm: 8}}, position_mm: [20, 0, 0]}}
    - {{name: outer, shape: {{kind: box, size_mm: [10, 20, 20]}}, position_mm: [-25, 0, 0]}}
    - {{name: about, shape: {{kind: shell, part: rod, from_mm: 2, to_mm: 6}}}}
  contrasts: [{{region: inner, against: outer}}]
  mtf: [{{at: ball}}, {{at: rod}}]
  nps: [{{region: outer}}]
  tasks:
    - {{name: lesion, signal: {{kind: gaussian, sigma_mm: 2, contrast_rel: 0.1}}, region: outer,
       scans: 3}}
  streaks: [{{part: rod, to_mm: 10}}]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "good.yaml"
    path.write_text(GOOD)
    return path


def test_what_is_asked_for_is_read(file: Path) -> None:
    section = load_scenario(file).evaluation
    assert section is not None
    assert [one.label for one in section.contrasts] == ["inner_against_outer"]
    assert section.region("about").shape.kind == "shell"
    assert (section.streaks[0].from_mm, section.streaks[0].to_mm) == (2, 10)
    assert load_scenario(DEMO).evaluation is None


@pytest.mark.parametrize(
    ("line", "replaced", "by", "said"),
    [
        (
            11,
            "part: rod",
            "part: rot",
            "regions.2.shape.part: unknown part or label 'rot'; choose from",
        ),
        (12, "region: inner", "region: inne", "contrasts.0.region: unknown region 'inne'"),
        (12, "against: outer", "against: ball", "contrasts.0.against: unknown region 'ball'"),
        (13, "at: rod", "at: water", "mtf.1.at: 'water' is neither a sphere nor a cylinder"),
        (13, "at: ball}}", "at: bowl}}", "mtf.0.at: unknown part or region 'bowl'; choose from"),
        (14, "region: outer", "region: out", "nps.0.region: unknown region 'out'; choose from"),
        (16, "region: outer", "region: out", "tasks.0.region: unknown region 'out'; choose"),
        (
            18,
            "part: rod",
            "part: screw",
            "streaks.0.part: unknown part or label 'screw'; choose from",
        ),
        (9, "name: inner", "name: ball", "regions.0.name: a part is also called 'ball'"),
        (10, "name: outer", "name: inner", "regions: 'inner' appears more than once"),
        (18, "to_mm: 10", "to_mm: 1", "to_mm (1) must be above from_mm (2)"),
        (10, "name: outer", "name: a.b", "regions.1.name"),
    ],
)
def test_what_is_wrong_is_told_where_it_is(
    file: Path, line: int, replaced: str, by: str, said: str
) -> None:
    lines = GOOD.splitlines()
    replaced, by = replaced.replace("}}", "}"), by.replace("}}", "}")
    assert lines[line - 1].count(replaced) == 1
    lines[line - 1] = lines[line - 1].replace(replaced, by)
    file.write_text("\n".join(lines))
    with pytest.raises(ScenarioError) as caught:
        load_scenario(file)
    (problem,) = [p for p in caught.value.problems if said in p]
    assert problem.startswith(f"{file}:") and "evaluation." in problem
    # A section that is wrong as a whole became so with the last of its keys.
    assert f":{line}: " in problem or "more than once" in problem


def test_an_override_is_named(file: Path) -> None:
    with pytest.raises(ScenarioError, match=r"--set.*nps.0.region: unknown region 'x'"):
        load_scenario(file, ["evaluation.nps=[{region: x}]"])
