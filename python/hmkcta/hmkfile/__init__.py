"""The `.hmk` file: reading, writing, limits and reason codes (`docs/format.md`)."""

from .limits import DEFAULT_LIMITS as DEFAULT_LIMITS
from .limits import Limits as Limits
from .lookalikes import is_hmk as is_hmk
from .metadata import INLINE_COORDS as INLINE_COORDS
from .metadata import KINDS as KINDS
from .metadata import VERSION as VERSION
from .metadata import coords_info as coords_info
from .metadata import coords_name as coords_name
from .publish import check_output as check_output
from .publish import published as published
from .read import load as load
from .read import loads as loads
from .read import table_bytes as table_bytes
from .reasons import REASONS as REASONS
from .reasons import WRITER_REASONS as WRITER_REASONS
from .reasons import Reason as Reason
from .schema import ArrayInfo as ArrayInfo
from .schema import level_schema as level_schema
from .schema import prefix as prefix
from .short import narrowest as narrowest
from .write import encode as encode
from .write import encoded_size as encoded_size
from .write import file_size as file_size
from .write import level_sizes as level_sizes
from .write import save as save
