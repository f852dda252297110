"""The version, in the one place that the package and the file's `writer` field read it from."""

__version__ = "0.1.0"
