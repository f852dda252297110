"""Formats in: files opened as NumPy arrays, memory-mapped where the format allows it.

| format | told by | how it is read |
| --- | --- | --- |
| `.npy` | its first bytes | mapped |
| `.npz` | its first bytes | a member that is not compressed is mapped, any other is read |
| raw binary | `shape` and `dtype` | mapped |

Nothing is unpickled, and no array is believed to be longer than its file.
"""

from .coordinates import read_coordinates as read_coordinates
from .open_array import open_array as open_array
