"""The head of a shader: the constants of one model, the pages of its image, and the contraction of a core.

The viewer makes the same text (`tests/corpus-render/prelude.json` holds the two together), and the files of
`hmkcta/shaders` follow it unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from math import prod

import numpy as np

from ..axes import axis_order
from ..errors import HmkctaError, Kind, invalid
from ..packed import Metadata, level_ends
from ..transform import from_json
from .cell_loops import picked_cells
from .core_sums import contraction
from .single_cell import is_single, single_cell
from .tree import Tree

#: Words of a page by its logarithm: 2^25 words are the 128 MiB that WebGPU guarantees for a storage buffer binding.
PAGE_SHIFT = 25
#: Of the 8 storage buffers that WebGPU guarantees a stage, those an image may take.
MOST_PAGES = 5
#: Rows of a mode are kept in a mask of one word.
MOST_ROWS = 32
#: In shaders and their uniforms: there is no such axis or mode.
NO_AXIS = 0xFF

#: Numbers of the value transforms in `decode.wgsl`.
TRANSFORM_NUMBERS = {"identity": 0, "log1p": 1, "asinh": 2, "sqrt": 3}
#: A little below the largest float32.
_LARGEST = 3.4e38


@dataclass(frozen=True)
class Options:
    """What a shader needs beside the model.

    Attributes:
        picks: for each source axis, how many weighted indices it can have; None for shaders without `weighted.wgsl`.
        channels: 3 if values are red, green and blue, decoded in one walk, else 1. The weights of the mode of the axis
            of role `channel` are then red, green and blue; those of other modes are single numbers.
        contracted: modes that `contract.wgsl` has folded into the cores. If the colours' is one of them, and there are
            three channels, the contracted cores hold colours.
        page_shift: logarithm of the words of a page of the image.
    """

    picks: tuple[int, ...] | None = None
    channels: int = 1
    contracted: tuple[int, ...] = ()
    page_shift: int = PAGE_SHIFT


#: Every axis at one index, single numbers.
PLAIN = Options()


def prelude(tree: Tree, pages: int, options: Options = PLAIN) -> str:
    """The constants and generated functions that the files of `hmkcta/shaders` are written against.

    Args:
        tree: what is known of the model.
        pages: of its image, from `image_pages`.
        options: of the shader.

    Raises:
        HmkctaError: `picks` are not one number of 1 or more an axis, or give a mode more than 32 rows; the channels
            are neither 1 nor 3.

    >>> from hmkcta._example import example_level, example_metadata
    >>> from hmkcta.render.tree import tree_of
    >>> prelude(tree_of(example_metadata(), [example_level()]), 1).splitlines()[1:3]
    ['const AXES = 2u;', 'const ORDER = 2u;']
    """
    if options.channels not in (1, 3):
        raise invalid("channels", "channels", options.channels, "1 or 3")
    metadata, order = tree.metadata, tree.order
    picks = _picks(metadata, options)
    modes, strides = axis_places(metadata)
    room = rooms(metadata, options)
    taken = [0 if n in options.contracted else tree.most(n, room[n]) for n in range(order)]
    colour, tinted = colour_mode(metadata, options)
    first = [sum(room[:n]) for n in range(order + 1)]
    lines = [
        "// Constants of one model: generated, not to be edited.",
        f"const AXES = {len(metadata.axes)}u;",
        f"const ORDER = {order}u;",
        *_tree(tree),
        f"const CONTRACTED = {_mask(options.contracted)}u;",
        f"const NODE_WORDS = {node_words(order)}u;",
        f"const AXIS_MODE = {_array(modes)};",
        f"const AXIS_STRIDE = {_array(strides)};",
        f"const RANK_SUM = {max(1, sum(taken))}u;",
        f"const WEIGHT_FIRST = {_array([sum(taken[:n]) for n in range(order)])};",
        f"const AXIS_PICKS = {_array(picks)};",
        f"const PICKS = {max(picks)}u;",
        f"const ROW_FIRST = {_array(first)};",
        f"const ROWS = {first[-1]}u;",
        f"const TRANSFORM = {TRANSFORM_NUMBERS[from_json(metadata.transform).name]}u;",
        f"const CHANNELS = {options.channels}u;",
        *_value(options.channels),
        f"const COLOUR_AXIS = {_or_none(None if options.channels == 1 else channel_axis(metadata))}u;",
        f"const COLOUR = {_or_none(colour)}u;",
        f"const COLOUR_ROWS = {1 if colour is None else room[colour]}u;",
        f"const COLOUR_RANKS = {1 if colour is None else max(taken[colour], 1)}u;",
        *_pages(pages, options.page_shift),
        *contraction(tree, taken, colour, options.contracted, tinted),
    ]
    if options.picks is not None and is_single(tree):
        lines += single_cell(tree, (modes, strides), colour, options.contracted, tinted)
    elif options.picks is not None:
        lines += picked_cells(tree, room, colour, options.contracted, tinted)
    return "\n".join(lines) + "\n"


def rooms(metadata: Metadata, options: Options) -> list[int]:
    """For each mode the most rows that it has at once: the product of its axes' picks.

    Raises:
        HmkctaError: `picks` are not one number of 1 or more an axis, or give a mode more than 32 rows.
    """
    found = _rows(metadata, _picks(metadata, options))
    for n, rows in enumerate(found):
        if rows > MOST_ROWS:
            raise invalid("picks-too-many", f"weighted rows of mode {n + 1}", rows, f"at most {MOST_ROWS}",
                          "interpolate along fewer of its axes")
    return found


def picks_fit(metadata: Metadata, picks: Sequence[int]) -> bool:
    """Whether there is room for `picks` weighted indices of each axis."""
    return max(_rows(metadata, picks)) <= MOST_ROWS


def _rows(metadata: Metadata, picks: Sequence[int]) -> list[int]:
    modes, _ = axis_places(metadata)
    order = range(len(metadata.organisation))
    return [prod(picks[axis] for axis, mode in enumerate(modes) if mode == n) for n in order]


def channel_axis(metadata: Metadata) -> int | None:
    """The first axis of role `channel`.

    >>> from dataclasses import replace
    >>> from hmkcta.axes import name_axes
    >>> from hmkcta._example import example_metadata
    >>> channel_axis(replace(example_metadata(), axes=name_axes((3, 4), ["rgb", "x"])))
    0
    """
    return next((axis for axis, found in enumerate(metadata.axes) if found.role == "channel"), None)


def colour_mode(metadata: Metadata, options: Options) -> tuple[int | None, bool]:
    """The mode whose weights are colours, and whether the contracted cores are instead; None and False without any."""
    axis = channel_axis(metadata)
    mode = None if axis is None or options.channels == 1 else axis_places(metadata)[0][axis]
    return (None, True) if mode is not None and mode in options.contracted else (mode, False)


def shader(name: str) -> str:
    """The text of a file of `hmkcta/shaders`, by its name without `.wgsl`.

    >>> "fn decode_element(" in shader("decode")
    True
    """
    return resources.files("hmkcta").joinpath("shaders", f"{name}.wgsl").read_text(encoding="utf-8")


def compose(head: str, *names: str) -> str:
    """One shader: the prelude and files of `hmkcta/shaders`, in this order."""
    return "\n".join([head, *(shader(name) for name in names)])


def compose_picked(head: str, *names: str) -> str:
    """One shader that decodes weighted sums: the prelude, the files of the decoder, and others."""
    walk = () if "fn decode_picked(" in head else ("weighted",)
    return compose(head, "image", "decode", "picks", *walk, *names)


def node_words(order: int) -> int:
    """Words of a node's record: child, core, scale, and C, K, R, rows, basis of every mode."""
    return 3 + 5 * order


def axis_places(metadata: Metadata) -> tuple[list[int], list[int]]:
    """For each source axis its mode, and by how many rows of the mode an index of it counts.

    >>> from hmkcta.axes import name_axes
    >>> from dataclasses import replace
    >>> from hmkcta._example import example_metadata
    >>> axes = name_axes((6, 8, 9, 3), ["light", "y", "x", "rgb"])
    >>> axis_places(replace(example_metadata(), axes=axes, organisation=(("light", "rgb"), ("y", "x"))))
    ([0, 1, 1, 0], [3, 9, 1, 1])
    """
    modes, strides = [0] * len(metadata.axes), [1] * len(metadata.axes)
    order = iter(axis_order(metadata.axes, metadata.organisation))
    for n, names in enumerate(metadata.organisation):
        members = [next(order) for _ in names]
        for i, axis in enumerate(members):
            modes[axis] = n
            strides[axis] = prod(metadata.axes[other].size for other in members[i + 1 :])
    return modes, strides


def decoder_uniform(metadata: Metadata, levels: int) -> bytes:
    """The 12 bytes of the uniform `Decoder`: stages of so many levels, scale and limit of the value transform.

    >>> from hmkcta._example import example_metadata
    >>> decoder_uniform(example_metadata(), 1).hex()
    '010000000000803f00000000'

    Raises:
        HmkctaError: not 1 to L levels.
    """
    if not 1 <= levels <= len(metadata.levels):
        raise invalid("level-out-of-range", "level", levels, f"1 to {len(metadata.levels)}")
    transform = from_json(metadata.transform)
    limit = float(transform.forward(np.array(_LARGEST))) if not transform.is_identity else 0.0
    numbers = np.array([transform.scale, limit], "<f4").tobytes()
    return np.uint32(level_ends(metadata.stages)[levels - 1]).astype("<u4").tobytes() + numbers


def image_pages(words: int, page_shift: int = PAGE_SHIFT) -> int:
    """Pages of an image of that many `words`.

    >>> image_pages(1 << 25), image_pages((1 << 25) + 1)
    (1, 2)

    Raises:
        HmkctaError: more than the storage buffers that WebGPU guarantees leave room for.
    """
    pages = max(1, -(-words >> page_shift))
    if pages > MOST_PAGES:
        most = MOST_PAGES << page_shift
        raise HmkctaError(Kind.RESOURCE_LIMIT, "image-too-large", "model", found=f"{4 * words} bytes on the GPU",
                          allowed=f"at most {4 * most}",
                          hint="show fewer levels (model.at_level), or compress with a smaller --size")
    return pages


def _picks(metadata: Metadata, options: Options) -> Sequence[int]:
    picks = options.picks if options.picks is not None else (1,) * len(metadata.axes)
    if len(picks) != len(metadata.axes) or min(picks) < 1:
        raise invalid("picks", "picks", picks, f"{len(metadata.axes)} numbers of 1 or more, one a source axis")
    return picks


def _tree(tree: Tree) -> list[str]:
    """How deep the tree is, and what holds in all its nodes."""
    masks = {"UNDECOMPOSED": tree.undecomposed, "MIXED": tree.mixed, "WHOLE": tree.whole}
    return [f"const STAGES = {len(tree.metadata.stages)}u;", f"const CUTS = {'true' if tree.cuts else 'false'};",
            *(f"const {name} = {_mask(modes)}u;" for name, modes in masks.items())]


def _value(channels: int) -> list[str]:
    """The type of values and weights, and the one with nothing but a channel."""
    kind, value = ("vec3f", "vec3f(f32(c == 0u), f32(c == 1u), f32(c == 2u))") if channels == 3 else ("f32", "1.0")
    return [f"alias Value = {kind};", "fn channel(c: u32) -> Value {", f"  return {value};", "}"]


def _pages(pages: int, shift: int) -> list[str]:
    """The bindings of the image's pages, and the function that reads a word of it."""
    bindings = [f"@group(0) @binding({page + 1}) var<storage, read> page_{page}: array<u32>;" for page in range(pages)]
    head = [f"const PAGE_SHIFT = {shift}u;", *bindings, "fn word(at: u32) -> u32 {"]
    if pages == 1:
        return [*head, "  return page_0[at];", "}"]
    inner = [f"    case {page}u: {{ return page_{page}[at & {(1 << shift) - 1}u]; }}" for page in range(pages - 1)]
    last = f"    default: {{ return page_{pages - 1}[at & {(1 << shift) - 1}u]; }}"
    return [*head, "  switch at >> PAGE_SHIFT {", *inner, last, "  }", "}"]


def _or_none(number: int | None) -> int:
    """The number of an axis or of a mode as the shaders have it."""
    return NO_AXIS if number is None else number


def _mask(modes: Sequence[int]) -> int:
    return sum(1 << n for n in modes)


def _array(numbers: Sequence[int]) -> str:
    return f"array<u32, {len(numbers)}>({', '.join(f'{number}u' for number in numbers)})"
