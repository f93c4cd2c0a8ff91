"""Studies: many scans from one file, each thing done once, safe against any death."""
