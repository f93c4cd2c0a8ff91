"""Plug-ins of every kind from outside the package, one file each."""
