"""Pictures of a model: by the shaders where there is an adapter, else by NumPy (`hmkcta render`; paper, section 5)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from ..conventions import meant
from ..errors import expect, invalid
from ..model import Model
from ..verbatim import check_shape
from .animate import default_motion, moving
from .display import Display, display_of, heat_gain, show
from .layout import lay_out, value_range
from .numpy_path import NumpyPath
from .scene import Scene
from .white import white_of

if TYPE_CHECKING:
    from .device import Device
    from .gpu_path import GpuPath

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

#: Further than any value from any other.
_FAR = 3e38

BACKENDS = ("auto", "gpu", "numpy")


def render(model: Model, scene: Scene | None = None, *, original: Any = None, backend: str = "auto") -> U8:
    """One picture ``[height, width, 3]``, uint8, of a model.

    Args:
        model: the model.
        scene: what to show; by default what suits the model's kind.
        original: an array of the model's shape, for scenes that compare with it.
        backend: ``gpu`` (wgpu), ``numpy``, or ``auto``: a GPU where there is one, else NumPy.

    Raises:
        HmkctaError: the scene does not fit the model; `backend` is ``gpu`` and there is no adapter.

    >>> from hmkcta import compress, synthetic
    >>> data = synthetic.light_field(views=2, size=12, frames=2)
    >>> model = compress(data.values, "R=2,2,6,6,2", axes=data.axes, kind=data.kind)
    >>> render(model, Scene(width=32, height=24), backend="numpy").shape
    (24, 32, 3)
    """
    expect("scene", scene, Scene | None, "a Scene")
    scene = scene or Scene()
    renderer = Renderer(model, original=original, backend=backend, kind=scene.kind, position=scene.position)
    return renderer.picture(scene)


@final
class Renderer:
    """Renders several scenes of one model; what they share is made once.

    Args:
        model, original, backend: as `render` takes them.
        kind: what to show it as; by default the model's.
        position: where axes stand that the renderer does not move along, by name.

    Attributes:
        kind: of `hmkcta.render.scene.KINDS`.
        backend: ``gpu`` or ``numpy``, what is used.
        gain: how many times as large as they are errors were shown last, None before any were.
        adapter: the name of the adapter, empty for NumPy.

    Raises:
        HmkctaError: the axes do not make this kind; `original` has another shape; no adapter, for ``gpu``.
    """

    def __init__(self, model: Model, *, original: Any = None, backend: str = "auto", kind: str | None = None,
                 position: dict[str, int] | None = None) -> None:
        expect("model", model, Model, "a Model", "open the file: hmkcta.open(path)")
        if backend not in BACKENDS:
            raise invalid("unknown-backend", "backend", repr(backend), ", ".join(BACKENDS))
        if original is not None:
            check_shape(tuple(original.shape), model.metadata)
        self.kind = kind or model.metadata.kind
        self._model = model
        self._original = meant(original)
        self._layout = lay_out(model.metadata.axes, self.kind, position)
        self._numpy = NumpyPath(model, model.metadata.axes, self._layout, self.kind, model)
        self._device = None if backend == "numpy" or self.kind == "generic" else _device(backend)
        self.gain: float | None = None
        self.backend = "numpy" if self._device is None else "gpu"
        self.adapter = "" if self._device is None else str(self._device)

    @property
    def notes(self) -> tuple[str, ...]:
        """What had to be assumed, in sentences."""
        assumed = "has no directions as coordinates: a Fibonacci spiral down to 75 degrees is assumed"
        return tuple(f"Axis {name!r} {assumed}." for name in self._numpy.assumed)

    def picture(self, scene: Scene) -> U8:
        """The picture ``[height, width, 3]`` of a scene.

        Raises:
            HmkctaError: the scene does not fit the model.
        """
        display = self.display(scene)
        one = self.radiance(scene)
        two = one if display.mode == "none" else self._compared(scene)
        if display.mode == "heat":
            if scene.compare.gain is None:
                display = replace(display, gain=heat_gain(one, two, display.exposure))
            self.gain = display.gain
            # What is no number in the original is as wrong as can be.
            two = np.nan_to_num(two, nan=_FAR, posinf=_FAR, neginf=-_FAR)
        if self._device is None:
            return show(one, two, display)
        from .gpu_display import show_on_gpu

        return show_on_gpu(self._device, one, two, display)

    def original_picture(self, scene: Scene) -> U8:
        """The picture of the original that was given, with the model's exposure.

        Raises:
            HmkctaError: there is no original; the scene does not fit it.
        """
        radiance = self._compared(replace(scene, compare=replace(scene.compare, level=None)))
        return show(radiance, radiance, replace(self.display(scene), mode="none"))

    def radiance(self, scene: Scene) -> F32:
        """Radiance and coverage ``[height, width, 4]``, before exposure; of a volume, display colours times opacity."""
        return self._radiance(scene, len(self._model.levels) if scene.level is None else scene.level)

    def frames(self, scene: Scene, motion: str | None = None, count: int = 48) -> Iterator[U8]:
        """Pictures of a film: `motion` is one of `hmkcta.render.animate.MOTIONS`, by default what suits the kind.

        Raises:
            HmkctaError: the motion does not suit the kind, or a scene does not fit the model.
        """
        axes = self._model.metadata.axes
        motion = motion or default_motion(self.kind, axes, self._layout)
        for moved in moving(scene, motion, count, self.kind, axes, self._layout):
            yield self.picture(moved)

    def display(self, scene: Scene) -> Display:
        """How a scene's radiance is shown; white that the data decide is taken from all levels, so that levels
        compare."""
        white, black = white_of(self._model.metadata.source_dtype, self.kind, self._model.metadata.axes), 0.0
        if self.kind == "generic" and scene.volume.window is not None:
            black, white = scene.volume.window
        elif white is None:
            low, white = self._range
            black = min(0.0, low) if self.kind == "generic" else 0.0
        return display_of(scene.tone, scene.compare, self.kind, white, black)

    def _compared(self, scene: Scene) -> F32:
        """Radiance of the other level, or of the original."""
        if scene.compare.level is not None:
            return self._radiance(scene, scene.compare.level)
        if self._original is None:
            raise invalid("no-original", "compare", f"{scene.compare.mode} without a level",
                          "the original array, or a level to compare with", "give original=ARRAY, or compare.level")
        return self._original_path.radiance(scene, None)

    @cached_property
    def _range(self) -> tuple[float, float]:
        return value_range(self._model, self._model.shape)

    def _radiance(self, scene: Scene, level: int) -> F32:
        if not 1 <= level <= len(self._model.levels):
            raise invalid("level-out-of-range", "level", level, f"1 to {len(self._model.levels)}")
        if self._gpu is not None:
            if (refusal := self._gpu.refusal(scene, level)) is not None:
                raise refusal
            return self._gpu.radiance(scene, level)
        return self._numpy.radiance(scene, level)

    @cached_property
    def _gpu(self) -> GpuPath | None:
        if self._device is None:
            return None
        from .gpu_path import GpuPath

        return GpuPath(self._device, self._model, self._layout, self.kind)

    @cached_property
    def _original_path(self) -> NumpyPath:
        return NumpyPath(self._original, self._model.metadata.axes, self._layout, self.kind, self._model)


def _device(backend: str) -> Device | None:
    """A device of an adapter; for ``auto`` None where there is none, or one in software, which NumPy outruns."""
    from .device import find_device, shared_device

    device = shared_device() if backend == "gpu" else find_device()
    return None if backend == "auto" and device is not None and device.software else device
