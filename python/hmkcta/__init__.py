"""Hierarchical multiway K-clustered tensor approximation: compress visual data, decode any element on its own."""

from .model import Model, open

__all__ = ["Model", "open"]
