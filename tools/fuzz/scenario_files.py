"""Fuzzing of scenario files: each must load, or be refused with a clear message."""

from __future__ import annotations

import copy
import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from cases import Case
from mutations import NASTY_TEXTS, broken, nasty, number_near

from twinct.core.errors import MemoryShortageError
from twinct.core.files.plain_yaml import read_file, written
from twinct.runs import needs, require_memory
from twinct.scenario import load_scenario, parse_scenario

SCENARIOS = Path(__file__).parents[2] / "scenarios"

ROUND_TRIPS = 0.1
"""Share of cases that write the scenario and read it again."""

Key = tuple[str | int, ...]

_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class Kind:
    """Mutants of the repository's scenarios.

    Attributes:
        data: the scenarios as plain data.
    """

    seconds = 2.0
    memory_bytes = 2**30

    def __init__(self, material: Path) -> None:
        """Copy the scenarios, and make the files that they name."""
        self._material = material
        (material / "data").mkdir(exist_ok=True)
        np.savetxt(material / "data" / "table.csv", np.arange(24).reshape(4, 6), delimiter=",")
        (material / "data" / "curve.txt").write_text("0 1\n1 0.5\n200 0.1\n")
        self._texts: list[str] = []
        self.data: list[dict[str, Any]] = []
        files = sorted(SCENARIOS.glob("*.yaml"))
        for file in files:  # copy all before reading any: one may extend another
            shutil.copy(file, material)
        for file in files:
            self._texts.append(file.read_text(encoding="utf-8"))
            own = yaml.safe_load(self._texts[-1])
            self.data.append(own)
            if "extends" in own:
                try:
                    whole = load_scenario(material / file.name)
                except Exception as error:  # the repository may lack its data
                    if "no file at" not in str(error):
                        raise
                    continue
                self.data.append(json.loads(whole.resolved()))

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case with changed bytes, lines or values."""
        text, told = rng.choice((self._bytes, self._lines, self._values))(rng)
        return self.loaded(rng, folder, text, told)

    def loaded(self, rng: random.Random, folder: Path, text: bytes, told: str) -> Case:
        """Write a scenario beside the files that it names; return the case that loads it."""
        path = folder / "mutant.yaml"
        for file in self._material.iterdir():
            (folder / file.name).symlink_to(file)
        path.write_bytes(text)
        again, by_needs = rng.random() < ROUND_TRIPS, rng.random() < 0.5
        return Case(told[:1000], lambda: _weighed(path, again, by_needs))

    def _bytes(self, rng: random.Random) -> tuple[bytes, str]:
        return broken(rng, rng.choice(self._texts).encode())

    def _lines(self, rng: random.Random) -> tuple[bytes, str]:
        lines = rng.choice(self._texts).splitlines()
        told: list[str] = []
        for _ in range(rng.randint(1, 3)):
            at = rng.randrange(len(lines))
            key, colon, _ = lines[at].partition(":")
            match rng.choice(("value", "value", "value", "out", "twice", "in", "move", "text")):
                case "value" if colon:
                    lines[at] = f"{key}: {rng.choice(NASTY_TEXTS)}"
                case "out" if len(lines) > 1:
                    del lines[at]
                case "twice":
                    lines.insert(at, lines[at])
                case "in":
                    lines[at] = " " * rng.randint(1, 8) + lines[at].lstrip()
                case "move":
                    lines.insert(rng.randrange(len(lines)), lines.pop(at))
                case _:
                    lines.insert(at, rng.choice(NASTY_TEXTS))
            told.append(f"line {at + 1} changed")
        end = rng.choice(("\n", "\n", "\n", "\r\n", "\r"))
        text = end.join(lines)
        return text.encode(
            rng.choice(("utf-8",) * 18 + ("utf-16", "latin-1")), "replace"
        ), ", ".join(told)

    def _values(self, rng: random.Random) -> tuple[bytes, str]:
        """Change one to four values, of which a list or section may be one."""
        data = copy.deepcopy(rng.choice(self.data))
        told: list[str] = []
        for _ in range(rng.choice((1, 1, 2, 4))):
            key = rng.choice(list(keys_of(data)))
            around, name = at(data, key[:-1]), key[-1]
            old = around[name]
            if rng.random() < 0.15:
                del around[name]
            elif isinstance(old, int | float) and rng.random() < 0.6:
                around[name] = number_near(rng, old)
            else:
                around[name] = nasty(rng)
            told.append(".".join(map(str, key)))
        return self.text_of(data), f"values: {', '.join(told)}"

    def valid_with(self, rng: random.Random, path: Path, key: Key) -> str:
        """Write a valid scenario with one changed section, or a few changed numbers in it."""
        data = copy.deepcopy(rng.choice([d for d in self.data if "specimen" in d]))
        for file in self._material.iterdir():
            (path.parent / file.name).symlink_to(file)
        for part in data["specimen"]["parts"]:
            if part["shape"]["kind"] in ("skull", "head", "brain"):
                part["shape"]["mesh_resolution_mm"] = 6.0  # faster to build
        here: Any = data
        for step in key[:-1]:
            here = here[step]
        section = here.get(key[-1], {}) if isinstance(here, dict) else here[key[-1]]
        numbers = [k for k in keys_of(section) if isinstance(at(section, k), int | float)]
        told: list[str] = []
        for inner in rng.sample(numbers, min(len(numbers), rng.choice((1, 1, 2, 3)))):
            at(section, inner[:-1])[inner[-1]] = number_near(rng, at(section, inner))
            told.append(".".join(map(str, inner)))
        path.write_bytes(self.text_of(data))
        return f"{'.'.join(map(str, key))}: {', '.join(told)}"

    @staticmethod
    def text_of(data: Any) -> bytes:
        """Return data as YAML."""
        text = yaml.dump(data, Dumper=_DUMPER, sort_keys=False, allow_unicode=True)
        return text.encode("utf-8", "replace")


def keys_of(data: Any, key: Key = ()) -> Iterator[Key]:
    """Yield the keys of all values in plain data."""
    inner = data.items() if isinstance(data, dict) else enumerate(data)
    for name, value in inner:
        yield (*key, name)
        if isinstance(value, dict | list):
            yield from keys_of(value, (*key, name))


def at(data: Any, key: Key) -> Any:
    """Return the value at a key."""
    for step in key:
        data = data[step]
    return data


def _weighed(path: Path, again: bool, by_needs: bool) -> str:
    scenario = load_scenario(path)
    if again:
        plain = json.loads(scenario.resolved())
        path.with_name("again.yaml").write_text(written(plain), encoding="utf-8")
        if read_file(path.with_name("again.yaml"), "scenario").value != plain:
            raise AssertionError("the YAML differs when it is read again")
        if parse_scenario(plain) != scenario:
            raise AssertionError("the scenario differs when it is read again")
    try:
        needs(scenario) if by_needs else require_memory(scenario)  # both compute all views
    except MemoryShortageError:
        return "scenario too large for this process"
    return "scenario"
