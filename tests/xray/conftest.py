"""The test directory itself is importable: ``xray_scenes`` holds what the test files share."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
