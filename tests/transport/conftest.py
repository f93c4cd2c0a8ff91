"""The test directory itself is importable: ``transport_bodies`` holds what the test files share."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
