"""Files that scenarios name travel by their content, with all that belongs to them."""

from __future__ import annotations

import shutil
from pathlib import Path

import trimesh

from twinct.core.files.arm_xml import read_arm_xml
from twinct.scenario import load_scenario
from twinct.study.inputs import Inputs

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"

ARM = """<mujoco model="arm">
  <compiler meshdir="parts"/>
  <asset><mesh file="block.stl"/></asset>
  <worldbody><body name="foot"><geom type="mesh" mesh="block"/>
    <include file="hand.xml"/></body></worldbody>
</mujoco>"""
HAND = '<mujoco><body name="hand"><joint name="turn"/><geom size="0.1"/></body></mujoco>'


class Offers(dict[str, Path]):
    """What a pool was offered."""

    def offer(self, name: str, path: Path) -> None:
        assert name not in self
        self[name] = path


def an_arm(folder: Path) -> Path:
    (folder / "parts").mkdir(parents=True)
    trimesh.creation.box((0.05, 0.05, 0.05)).export(folder / "parts" / "block.stl")
    (folder / "hand.xml").write_text(HAND)
    (folder / "arm.xml").write_text(ARM)
    return folder / "arm.xml"


def test_an_arm_travels_with_what_it_includes_and_names(tmp_path: Path) -> None:
    arm, pool = an_arm(tmp_path / "here"), Offers()
    scenario = load_scenario(DEMO, [f"cell.source_arm={{model: null, file: {arm}}}"])
    found = Inputs(tmp_path / "inputs").offered(scenario.files(), pool)  # pyright: ignore[reportArgumentType]
    ((key, (name, inner)),) = found.items()
    assert key == "cell.source_arm.file"
    there = tmp_path / "there"
    shutil.copytree(pool[name], there)  # as another machine has it
    shutil.rmtree(tmp_path / "here")
    files = read_arm_xml(there / inner, "arm").files
    assert sorted(file.name for file in files) == ["arm.xml", "block.stl", "hand.xml"]


def test_a_content_is_offered_once_and_under_another_name_when_it_changes(tmp_path: Path) -> None:
    views, pool = tmp_path / "views.csv", Offers()
    keys = [f"trajectory={{kind: file, path: {views}}}"]
    views.write_text("0,0,300,0,0,-300\n")
    inputs = Inputs(tmp_path / "inputs")
    scenario = load_scenario(DEMO, keys)
    first = inputs.offered(scenario.files(), pool)  # pyright: ignore[reportArgumentType]
    again = inputs.offered(scenario.files(), pool)  # pyright: ignore[reportArgumentType]
    assert first == again
    name, inner = first["trajectory.path"]
    assert (pool[name], inner, name.endswith("-views.csv")) == (views, "", True)
    views.write_text("0,0,300,0,0,-301\n")
    other = Inputs(tmp_path / "inputs").offered(scenario.files(), Offers())  # pyright: ignore[reportArgumentType]
    assert other["trajectory.path"][0] != name
