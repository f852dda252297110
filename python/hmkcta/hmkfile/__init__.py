"""The `.hmk` file: reading, writing, limits and reason codes (`docs/format.md`)."""

from .coding import root_places as root_places
from .coding import stage_arrays as stage_arrays
from .container import VERSION as VERSION
from .limits import DEFAULT_LIMITS as DEFAULT_LIMITS
from .limits import Limits as Limits
from .lookalikes import is_hmk as is_hmk
from .metadata import INLINE_COORDS as INLINE_COORDS
from .metadata import KINDS as KINDS
from .publish import check_output as check_output
from .publish import published as published
from .publish import remove_stale as remove_stale
from .read import level_bytes as level_bytes
from .read import load as load
from .read import load_open as load_open
from .read import loads as loads
from .read import open_regular as open_regular
from .reasons import REASONS as REASONS
from .reasons import WRITER_REASONS as WRITER_REASONS
from .reasons import Reason as Reason
from .write import encode as encode
from .write import encoded_size as encoded_size
from .write import file_digest as file_digest
from .write import level_sizes as level_sizes
from .write import save as save
