"""Tool paths."""

from ._path import Path as Path, vertical_path as vertical_path
