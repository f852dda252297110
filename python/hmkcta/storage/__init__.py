"""The coded runs of a file, readable: the twin of the native coder, which tests hold it to (`docs/format.md`)."""

from .run_code import Node as Node
from .run_code import Place as Place
from .run_code import decode_run as decode_run
from .run_code import encode_run as encode_run
