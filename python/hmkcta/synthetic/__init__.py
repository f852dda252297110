"""Test data that hmkcta makes itself: seeded, float32, with named axes, a few seconds on one core.

Three kinds, one for each renderer: `material` (SVBRDF), `volume` (time-varying volume), `light_field`. Besides these,
`svbrdf_from_parameters` turns measured parameter maps into a real SVBRDF of any size.
"""

from .dataset import KINDS, Dataset
from .directions import hemisphere_directions
from .jet import volume
from .layers import light_field
from .maps import MaterialMaps, brocade_maps
from .microfacet import material
from .sheet import SheetMaps, load_sheet, svbrdf_from_parameters

__all__ = [
    "KINDS",
    "Dataset",
    "MaterialMaps",
    "SheetMaps",
    "brocade_maps",
    "hemisphere_directions",
    "light_field",
    "load_sheet",
    "material",
    "svbrdf_from_parameters",
    "volume",
]
