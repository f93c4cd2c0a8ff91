"""Version of twinct."""

__version__ = "1.0.0.dev0"
