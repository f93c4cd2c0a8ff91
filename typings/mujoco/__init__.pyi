# The mujoco wheel brings compiled modules without type information; this keeps the type checker
# from reporting every name in them as missing.
from typing import Any

def __getattr__(name: str) -> Any: ...
