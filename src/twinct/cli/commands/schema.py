"""``twinct schema``: the JSON Schema of the scenario file."""

from __future__ import annotations

import json
import sys

from twinct.scenario import scenario_schema


def schema() -> None:
    """Print the JSON Schema of the scenario file, for editors."""
    sys.stdout.write(json.dumps(scenario_schema(), indent=2) + "\n")
