"""The command line: `hmkcta compress | plan | info | verify | decompress | demo`. A file for each command."""

from .app import main as main
