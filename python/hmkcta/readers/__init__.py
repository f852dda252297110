"""Formats in: files opened as NumPy arrays, mapped where the format allows it, else read or unpacked.

`formats.py` has the table of them, docs/inputs.md what they mean for the axes. Nothing is unpickled, and no array is
believed to be longer than its file.
"""

from .coordinates import read_coordinates as read_coordinates
from .open_array import open_array as open_array
from .open_array import source_files as source_files
from .watched import WatchedSource as WatchedSource
