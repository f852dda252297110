"""Rendering a model straight from its compressed form (paper, sections 5.1 to 5.3): `render`, `Scene` and its parts.

A picture is made by the WGSL shaders through wgpu where there is an adapter, else by NumPy. docs/rendering.md.
"""

from .renderer import Renderer, render
from .scene import Camera, Compare, Light, Look, Scene, Surface, Tone, Viewpoint, load_scene, scene_from_json

__all__ = [
    "Camera",
    "Compare",
    "Light",
    "Look",
    "Renderer",
    "Scene",
    "Surface",
    "Tone",
    "Viewpoint",
    "load_scene",
    "render",
    "scene_from_json",
]
