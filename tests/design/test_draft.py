"""A draft changes only the lines of its edits, and survives whatever ends its process."""

from __future__ import annotations

import os
import random
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from twinct.core.errors import InputError, ScenarioError
from twinct.core.files.plain_yaml import read_text
from twinct.design.draft import Draft
from twinct.design.kept import kept_beside, path_beside
from twinct.scenario import load_scenario
from twinct.scenario.reading import drafted

TEXT = """\
# A scan of a skull.   Kept as it is!
extends: paper     # the paper's room
name:   small
description: >
  Two lines
  of text.

detector: {columns: 160, rows: 120,   pixel_pitch_mm: 2.0}  # coarse
trajectory:
    # fewer views
    views: 100
    longitude_range_deg: 210 # 180 + opening angle
specimen:
  parts:
  - name: skull # first
    shape: {kind: skull}
  -   name: ball
      shape:
        kind: sphere # round
        radius_mm: 10
      position_mm:
      - 1
      - 2   # y
      - 3
reconstruction:
  grid: {voxels: [64,  64, 64], # cube
         voxel_mm: 2.5}

# the end
"""

KEYS = {
    "name": ["a", "b-1"],
    "detector.columns": [64, 320],
    "detector.rows": [48, 240],
    "detector.pixel_pitch_mm": [1, 0.5],
    "trajectory.views": [10, 50, 399],
    "trajectory.longitude_range_deg": [90, 123.5],
    "specimen.parts.0.name": ["head", "x"],
    "specimen.parts.1.shape.radius_mm": [5, 7.25],
    "specimen.parts.1.position_mm": [[4, 5, 6], [0, -1.5, 2]],
    "specimen.parts.1.position_mm.1": [8, 9],
    "reconstruction.grid.voxels.2": [32, 96],
    "reconstruction.grid.voxel_mm": [1.25, 3],
    # Keys that the file does not have yet.
    "seed": [2, 3],
    "trajectory.periods": [2, 3],
    "detector.pixel_samples": [2, 3],
    "source.energy_kev": [70, 90.5],
    "cell.source_arm.base_position_mm": [[800, 0, 0], [850, 10, -20]],
    "cell.detector_arm.base_position_mm.0": [-900, -800],
    "reconstruction.iterations": [2, 4],
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "scan.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def comments(text: str) -> list[str]:
    return re.findall(r"#.*", text)


def value_at(text: str, dotted: str, path: Path) -> object:
    from twinct.scenario import ScenarioText

    data: object = drafted(ScenarioText(path, text)).data
    for step in dotted.split("."):
        data = data[int(step)] if isinstance(data, list) else data[step]  # type: ignore[index]
    return data


def own_lines(text: str, dotted: str) -> tuple[int, int] | None:
    """The lines of a value that is there, from 0 to behind the last."""
    lines = read_text(text, "text", "scenario").lines
    steps = tuple(int(s) if s.isdigit() else s for s in dotted.split("."))
    if steps not in lines:
        return None
    inner = [line for key, line in lines.items() if key[: len(steps)] == steps]
    return min(inner) - 1, max(inner)


def only_its_own(before: str, after: str, dotted: str) -> None:
    """Only lines of the value differ; a new value adds lines, or stands on its section's line."""
    old, new, place = before.splitlines(), after.splitlines(), own_lines(before, dotted)
    if place is not None:
        start, end = place
        assert old[:start] == new[:start]
        assert old[end:] == new[len(new) - len(old) + end :]
        assert len(new) == len(old)
        return
    first = next(k for k, (a, b) in enumerate(zip([*old, None], new, strict=False)) if a != b)
    added = len(new) - len(old)
    if added:
        assert old[first:] == new[first + added :]  # nothing but new lines
        return
    assert old[first + 1 :] == new[first + 1 :]  # one line, of a section in braces
    assert dotted.rpartition(".")[0].rpartition(".")[2] + ":" in old[first]


def test_200_random_edits_change_only_their_own_lines(file: Path) -> None:
    rng, draft = random.Random(65), Draft.open(file)
    texts = [draft.text]
    for _ in range(200):
        dotted = rng.choice(list(KEYS))
        value = rng.choice(KEYS[dotted])
        draft.set({dotted: value})
        only_its_own(texts[-1], draft.text, dotted)
        assert value_at(draft.text, dotted, file) == value
        assert comments(draft.text) == comments(TEXT)
        assert draft.problems == ()
        texts.append(draft.text)
    for text in reversed(texts[:-1]):
        draft.undo()
        assert draft.text == text
    assert draft.text == TEXT and not draft.can_undo
    draft.undo()
    for text in texts[1:]:
        draft.redo()
        assert draft.text == text
    assert not draft.can_redo


def test_a_list_of_the_extended_file_is_taken_over_whole(tmp_path: Path) -> None:
    path = tmp_path / "short.yaml"
    path.write_text("extends: paper\n# mine\n", encoding="utf-8")
    draft = Draft.open(path)
    draft.set({"specimen.parts.0.position_mm": [1, 2, 3]})
    assert draft.scenario is not None
    assert draft.scenario.specimen.parts[0].position_mm == (1, 2, 3)
    assert draft.scenario.specimen.parts[0].label == "skull"
    assert draft.text.startswith("extends: paper\n# mine\n")


def test_a_removed_entry_takes_only_its_lines(file: Path) -> None:
    from twinct.design.edits import Edit

    draft = Draft.open(file)
    draft.apply(Edit({}, ("specimen.parts.1",)))
    assert draft.scenario is not None and len(draft.scenario.specimen.parts) == 1
    assert comments(draft.text) == [c for c in comments(TEXT) if c not in ("# round", "# y")]
    draft.apply(Edit({}, ("detector.columns",)))
    assert "detector: {rows: 120,   pixel_pitch_mm: 2.0}  # coarse" in draft.text
    with pytest.raises(ScenarioError, match="no such key"):
        draft.apply(Edit({}, ("detector.columns",)))


def test_edits_of_one_gesture_are_one(file: Path) -> None:
    draft = Draft.open(file)
    for views in (20, 30, 40):
        draft.set({"trajectory.views": views}, gesture="slider")
    draft.set({"trajectory.views": 50}, gesture="another")
    assert len(draft.edits) == 2
    draft.undo()
    assert draft.scenario is not None and draft.scenario.trajectory.views == 40  # type: ignore[union-attr]
    draft.undo()
    assert draft.text == TEXT


@pytest.mark.parametrize("key", ["name.inner", "specimen.parts.7.name", "trajectory..views"])
def test_a_key_that_leads_nowhere_changes_nothing(file: Path, key: str) -> None:
    draft = Draft.open(file)
    with pytest.raises(ScenarioError):
        draft.set({key: 1})
    assert draft.text == TEXT and draft.is_saved and not path_beside(file).exists()


def test_an_invalid_value_is_an_edit_with_problems(file: Path) -> None:
    draft = Draft.open(file)
    good = draft.scenario
    draft.set({"trajectory.views": -3})
    assert f"{file}:11: trajectory.views" in draft.problems[0]
    assert draft.scenario is good
    draft.undo()
    assert draft.problems == ()


def test_a_file_that_does_not_parse_opens_with_its_messages(file: Path) -> None:
    file.write_text("trajectory: {views: [\n", encoding="utf-8")
    draft = Draft.open(file)
    assert draft.scenario is None and "not valid YAML" in draft.problems[0]
    with pytest.raises(ScenarioError):
        draft.set({"seed": 2})
    assert draft.text == "trajectory: {views: [\n"


def test_saving_ends_the_kept_draft(file: Path) -> None:
    draft = Draft.open(file)
    draft.set({"seed": 7})
    assert path_beside(file).is_file() and not draft.is_saved
    draft.save()
    assert draft.is_saved and not path_beside(file).exists()
    assert load_scenario(file).seed == 7
    draft.undo()
    assert not draft.is_saved and path_beside(file).is_file()
    assert Draft.open(file).text == TEXT


def test_a_change_by_another_program_is_noticed(file: Path) -> None:
    draft = Draft.open(file)
    draft.set({"seed": 7})
    theirs = TEXT.replace("views: 100", "views: 33")
    file.write_text(theirs, encoding="utf-8")
    assert draft.changed_outside()
    with pytest.raises(InputError, match="another program"):
        draft.save()
    assert file.read_text(encoding="utf-8") == theirs
    draft.take_over()
    assert not draft.changed_outside() and draft.scenario is not None
    assert (draft.scenario.seed, draft.scenario.trajectory.views) == (7, 33)  # type: ignore[union-attr]
    draft.save()
    assert "views: 33" in file.read_text(encoding="utf-8")


def test_an_edit_that_does_not_fit_to_their_file_is_named(file: Path) -> None:
    draft = Draft.open(file)
    draft.set({"specimen.parts.1.position_mm.0": 5})
    draft.set({"seed": 7})
    file.write_text("extends: paper\n", encoding="utf-8")
    draft.take_over()
    assert [edit.words for edit in draft.dropped] == ["specimen.parts.1.position_mm.0: 5"]
    assert draft.scenario is not None and draft.scenario.seed == 7


def test_a_draft_of_a_changed_file_comes_back_and_is_not_written_over_it(file: Path) -> None:
    Draft.open(file).set({"seed": 7})
    file.write_text(TEXT + "# theirs\n", encoding="utf-8")
    again = Draft.open(file)
    assert again.scenario is not None and again.scenario.seed == 7
    with pytest.raises(InputError, match="another program"):
        again.save()


def test_changed_lines_are_marked(file: Path) -> None:
    draft = Draft.open(file)
    draft.set({"trajectory.views": 50})
    marked = [line for line in draft.compare() if line.mark != " "]
    assert marked == [("-", "    views: 100"), ("+", "    views: 50")]


def test_the_copied_command_is_the_draft(file: Path) -> None:
    draft = Draft.open(file)
    draft.set({"trajectory.views": 50})
    draft.set({"specimen.parts.1.name": "it's a ball"})
    words = shlex.split(draft.command())
    assert words[:3] == ["twinct", "run", "scan.yaml"]
    overrides = [words[k + 1] for k, word in enumerate(words) if word == "--set"]
    assert load_scenario(file, overrides) == draft.scenario
    program = draft.python()
    loaded: dict[str, object] = {}
    program = program.replace("'scan.yaml'", repr(str(file))).replace("run(", "repr(scenario), (")
    exec(program, loaded)
    assert loaded["scenario"] == draft.scenario


def test_a_new_file_begins_with_a_text(tmp_path: Path) -> None:
    path = tmp_path / "new.yaml"
    draft = Draft.open(path, "extends: demo\n")
    assert draft.scenario is not None and not draft.is_saved
    with pytest.raises(ScenarioError, match="save it"):
        draft.command()
    draft.save()
    assert path.read_text(encoding="utf-8") == "extends: demo\n"


def test_a_folder_that_cannot_be_written_is_said(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draft = Draft.open(file)

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("twinct.design.kept.write_json", refuse)
    draft.set({"seed": 7})
    assert "the disk is full; the draft is only in memory" in draft.unkept
    assert draft.scenario is not None and draft.scenario.seed == 7
    monkeypatch.undo()
    draft.set({"seed": 8})
    assert draft.unkept == ""


def test_something_else_beside_the_file_is_not_a_draft(file: Path) -> None:
    path_beside(file).write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match="no draft"):
        Draft.open(file)


EDITING = """
import sys
from pathlib import Path
from twinct.design.draft import Draft
draft = Draft.open(Path(sys.argv[1]))
for seed in range(1, 100000):
    draft.set({"seed": seed})
    print(seed, flush=True)
"""


@pytest.mark.slow
@pytest.mark.process
def test_a_killed_process_keeps_all_but_the_last_edit(file: Path) -> None:
    rng = random.Random(30)
    for _ in range(30):
        path_beside(file).unlink(missing_ok=True)
        process = subprocess.Popen(
            [sys.executable, "-c", EDITING, str(file)], stdout=subprocess.PIPE, env=dict(os.environ)
        )
        assert process.stdout is not None
        said = 0
        for _ in range(rng.randrange(1, 6)):
            said = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().split()
        process.wait()
        said = int(rest[-1]) if rest else said
        kept = kept_beside(file)
        assert kept is not None and kept.done in (said, said + 1)
        draft = Draft.open(file)
        assert draft.scenario is not None and draft.scenario.seed == kept.done
        assert file.read_text(encoding="utf-8") == TEXT
