"""Write docs/validation/: one page a topic from the records in benchmarks/results/*.json."""

from __future__ import annotations

import json
import sys
from collections import Counter
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
RECORDS = ROOT / "benchmarks" / "results"
PAGES = ROOT / "docs" / "validation"

MARKS = {"yes": "✅ met", "no": "❌ **missed**", "reported": "reported"}
"""Word by the value of ``met``; a row without a figure asked for is only reported."""

ORDER = (
    "paper",
    "full_size",
    "ways",
    "reach",
    "projections",
    "physics",
    "mesh_engine",
    "patients",
    "ctsimu",
    "reconstruction",
    "quality",
    "cuda",
    "figures",
    "uncertainty",
    "calibration",
    "measured",
    "planning",
    "exports",
    "studies",
    "nodes",
    "recording",
    "viewer",
    "damage",
    "faults",
    "input",
    "strangers",
    "tests",
    "package",
)
"""Topics as the index lists them: the experiment, its images, the volume, then the program."""

INDEX = """# Validation

These pages list every figure that we claim, with the command that measures it. Each topic has a
page. A row states the measured quantity, the figure asked for and the measured one: ✅ met,
❌ missed, or reported if no figure was asked for. Missed figures stay in the list.

Unless a page says otherwise, the machine was this one:
{machine}.
Because the machine was shared, compare the ratios of one run rather than the times of two runs.
OpenGL ran in software.

| topic | question | met | missed | reported |
|---|---|---|---|---|
{rows}

`python tools/validation_pages.py` makes these pages from the records in
`benchmarks/results/*.json`. To add a figure, add a record with one fact there, then run this
command.

```{{toctree}}
:hidden:

{pages}
```
"""


USUAL = "2 shared cores without a graphics card, Debian 12, Python 3.11, locked package versions"
"""Machine of most topics; the index states it, and a page names its machine if it differs."""


class Topic(NamedTuple):
    """The records of one page."""

    name: str
    title: str
    question: str
    machine: str
    conditions: str
    records: list[dict[str, str]]
    notes: list[str]

    def count(self, met: str) -> int:
        """Return the number of records with this mark."""
        return Counter(record["met"] for record in self.records)[met]


def topics() -> list[Topic]:
    """Return all topics in the order of the index."""
    found = {file.stem: read(file) for file in RECORDS.glob("*.json")}
    missing = found.keys() ^ set(ORDER)
    if missing:
        raise SystemExit(f"ORDER and {RECORDS} differ: {sorted(missing)}")
    return [found[name] for name in ORDER]


def read(file: Path) -> Topic:
    """Return the topic of a file."""
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return Topic(file.stem, **content)


def pages() -> dict[str, str]:
    """Return the text of each page by its file name."""
    every = topics()
    return {"index.md": _index(every)} | {f"{topic.name}.md": _page(topic) for topic in every}


def _index(every: list[Topic]) -> str:
    rows = [
        f"| [{topic.title}]({topic.name}.md) | {topic.question} | {_counts(topic)} |"
        for topic in every
    ]
    sums = (f"**{sum(topic.count(met) for topic in every)}**" for met in MARKS)
    rows.append(f"| **all** | | {' | '.join(sums)} |")
    names = "\n".join(topic.name for topic in every)
    return INDEX.format(machine=USUAL, pages=names, rows="\n".join(rows))


def _counts(topic: Topic) -> str:
    return " | ".join(str(topic.count(met) or "") for met in MARKS)


def _page(topic: Topic) -> str:
    dates = sorted({record["date"] for record in topic.records if "date" in record})
    until = f" Latest measurement: {dates[-1]}." if dates else ""
    counts = ", ".join(
        f"{topic.count(met)} {word}"
        for met, word in (("yes", "met"), ("no", "missed"), ("reported", "only reported"))
        if topic.count(met)
    )
    lines = [f"# {topic.title}\n", f"{topic.question} {counts[0].upper()}{counts[1:]}.{until}\n"]
    if topic.machine != USUAL:
        lines.append(f"Machine: {topic.machine}.\n")
    if topic.conditions:
        lines.append(f"{topic.conditions}\n")
    lines.append("The last column gives the number of the command below the table.\n")
    for group, records in groupby(topic.records, key=lambda record: record.get("group", "")):
        lines += [f"## {group}\n"] * bool(group)
        lines += _table(list(records))
    if topic.notes:
        lines += ["## Remarks\n", "\n\n".join(topic.notes)]
    return "\n".join(lines).rstrip() + "\n"


def _table(records: list[dict[str, str]]) -> list[str]:
    """Return one table of records, and the commands that measure them, folded away.

    Where every record states its seeds, there is a column for them.
    """
    commands = list(dict.fromkeys(record["command"] for record in records))
    names = ["what", "asked", "measured"] + ["seeds"] * all("seeds" in record for record in records)
    titles = {"what": "measured quantity", "asked": "asked for"}
    head = ["", *(titles.get(name, name) for name in names), "command"]
    lines = [f"| {' | '.join(head)} |".replace("|  |", "| |"), "|---" * len(head) + "|"]
    for record in records:
        shown = " | ".join(record.get(name, "").replace("|", r"\|") for name in names)
        number = commands.index(record["command"]) + 1
        lines.append(f"| {MARKS[record['met']]} | {shown} | {number} |")
    listed = [f"{number}. `{command}`" for number, command in enumerate(commands, 1)]
    fold = "<details>\n<summary>Commands that measure these figures</summary>\n"
    return [*lines, "", fold, *listed, "\n</details>\n"]


def main() -> int:
    """Write the pages and remove those without a topic."""
    texts = pages()
    PAGES.mkdir(exist_ok=True)
    for name, text in texts.items():
        (PAGES / name).write_text(text, encoding="utf-8")
    for page in PAGES.glob("*.md"):
        if page.name not in texts:
            page.unlink()
    sys.stdout.write(f"wrote {len(texts)} pages into {PAGES.relative_to(ROOT)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
