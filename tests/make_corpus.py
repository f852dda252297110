"""Write `tests/corpus/cases.json`: files that readers must refuse, and why. Run as ``python tests/make_corpus.py``."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from hmk_corpus import CORPUS, FIXTURES, Parts
from hmkcta.hmkfile import REASONS
from hmkcta.storage.contexts import code_integer, code_label
from hmkcta.storage.range_coder import Encoder

SMALL, MERGED, OWN, HALF = (f"v1-{name}.hmk" for name in ("small", "merged", "own", "half"))

Cases = list[dict[str, Any]]


def parts_of(name: str) -> Parts:
    """A fixture, taken apart."""
    return Parts.split((FIXTURES / name).read_bytes())


def case(
    name: str, base: str, edits: list[dict[str, Any]], reason: str, where: str | None = None, **limits: int
) -> dict[str, Any]:
    """One case; of the kind that its reason has."""
    told: dict[str, Any] = {
        "name": name,
        "base": base,
        "edits": edits,
        "kind": REASONS[reason].kind.value[0],
        "reason": reason,
    }
    return {**told, **({"where": where} if where else {}), **({"limits": limits} if limits else {})}


def header(*path: str | int, **to: Any) -> dict[str, Any]:
    """An edit of the header: `to` is put at a path, or without it what is there left out."""
    return {"op": "header", "path": list(path), **to}


def text(old: str, new: str) -> dict[str, Any]:
    """An edit of the header's text."""
    return {"op": "text", "from": old.encode().hex(), "hex": new.encode().hex()}


#: Files of other formats, and of none.
FOREIGN = [
    ("a PNG file", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"),
    ("a web page", b"<!DOCTYPE html>\n<html><body>404</body></html>"),
    ("a web page behind white space", b"\n \t<HTML lang=en><head></head></html>"),
    ("a gzip file", b"\x1f\x8b\x08" + bytes(55)),
    ("a zstd file", b"\x28\xb5\x2f\xfd" + bytes(54)),
    ("a JPEG file", b"\xff\xd8\xff\xe0\0\x10JFIF\0\x01" + bytes(48)),
    ("a TIFF file", b"II*\0\x08" + bytes(53)),
    ("an array of NumPy's", b"\x93NUMPY\x01\0v\0{'descr': '<f4'}" + bytes(48)),
    ("a zip archive", b"PK\x03\x04\x14\0\0\0\0\0"),
    ("HDF5", b"\x89HDF\r\n\x1a\n" + bytes(48)),
    ("a pointer of Git LFS", b"version https://git-lfs.github.com/spec/v1\n"),
    ("plain text", b"plain text of somebody\n"),
    ("JSON text", b'{"shape": [3, 4], "data": []}\n'),
    ("a safetensors file", b"\x02\0\0\0\0\0\0\0{}"),
    ("three letters", b"hi\n"),
    ("zeros", bytes(100)),
    ("random bytes", bytes(range(200, 230)) * 3),
]


def frame_cases() -> Cases:
    """What a file begins with, its length, its checksums."""
    size = len((FIXTURES / SMALL).read_bytes())
    ends = [
        case(f"cut to {n} bytes", SMALL, [{"op": "truncate", "size": n}], "truncated", "header") for n in (0, 5, 19, 60)
    ]
    return [
        *ends,
        case("without its last byte", SMALL, [{"op": "truncate", "size": size - 1}], "truncated", "data"),
        case("one byte more", SMALL, [{"op": "append", "hex": "00"}], "trailing-bytes", "data"),
        case("another first byte", SMALL, [{"op": "bytes", "at": 0, "hex": "88"}], "foreign-file", "header"),
        *[case(name, "", [{"op": "append", "hex": start.hex()}], "foreign-file", "header") for name, start in FOREIGN],
        case("version 2", SMALL, [{"op": "bytes", "at": 8, "hex": "02"}], "version-unknown", "header"),
        case("a header of 4 GiB", SMALL, [{"op": "bytes", "at": 12, "hex": "ffffffff"}], "header-too-large", "header"),
        case("a bit of the header", SMALL, [{"op": "bytes", "at": 30, "hex": "00"}], "header-crc", "header"),
        case(
            "the checksum of the header", SMALL, [{"op": "bytes", "at": 16, "hex": "00000000"}], "header-crc", "header"
        ),
        case(
            "the last byte", SMALL, [{"op": "bytes", "at": size - 1, "hex": "00"}], "section-crc", "stages[0].runs[0]"
        ),
        case(
            "a coordinate",
            MERGED,
            [{"op": "bytes", "at": len(parts_of(MERGED).text) + 21, "hex": "aa"}],
            "section-crc",
            "axes[0].coordinates",
        ),
    ]


def json_cases() -> Cases:
    """Texts that are no strict JSON."""
    return [
        case("white space", SMALL, [text('"axes":', '"axes": ')], "json-syntax", "header"),
        case("a new line", SMALL, [text('"axes":', '"axes":\n')], "header-bytes", "header"),
        case("an upper-case escape", SMALL, [text("µm", "\\u00B5m")], "header-bytes", "header"),
        case("half a pair", SMALL, [text("µm", "\\ud800")], "json-encoding", "header"),
        case("no UTF-8", SMALL, [{"op": "text", "from": "µ".encode().hex(), "hex": "ff"}], "json-encoding", "header"),
        case("white space behind another fault", SMALL, [text('"dtype":', '"dtype":1e999, "dtype":')], "json-syntax",
             "header"),
        case("no object", SMALL, [text("{", "{{")], "json-syntax", "header"),
        case("a key twice", SMALL, [text('"dtype":', '"dtype":"int8","dtype":')], "json-duplicate-key", "header"),
        case("NaN", SMALL, [text('"seed":7', '"seed":NaN')], "json-number", "header"),
        case("an overflow", SMALL, [text('"seed":7', '"seed":1e999')], "json-number", "header"),
        case("a large whole number", SMALL, [text('"seed":7', '"seed":9007199254740993')], "json-number", "header"),
        case("deep", SMALL, [header("source", to=[[]])], "json-depth", "header", json_depth=2),
        case("a long text", SMALL, [header("writer", to="x" * 5000)], "json-string", "header"),
        case("a long header", SMALL, [], "header-too-large", "header", json_bytes=100),
    ]


#: What is wrong with the small file's header, the edit that makes it so, the reason, and where it is found.
ROOT = ("stages", 0)
BAD_FIELDS: list[tuple[str, dict[str, Any], str, str]] = [
    ("no axes", header("axes"), "field-missing", "header.axes"),
    ("a field too many", header("version", to=1), "field-unknown", "header.version"),
    ("a size as a text, of an axis whose name is another's",
     text('"name":"t","size":3', '"name":"höhe","size":"3"'), "field-type", "header.axes[1].size"),
    ("a size as a text", header("axes", 0, "size", to="4"), "field-type", "header.axes[0].size"),
    ("a size of 0", header("axes", 0, "size", to=0), "field-value", "header.axes[0].size"),
    ("a size of 4.0", text('"size":4', '"size":4.0'), "field-type", "header.axes[0].size"),
    ("a name with a plus", header("axes", 0, "name", to="a+b"), "field-value", "header.axes[0].name"),
    ("a name twice", header("axes", 1, "name", to="höhe"), "field-value", "header.axes[1].name"),
    ("an unknown role", header("axes", 0, "role", to="depth"), "field-value", "header.axes[0].role"),
    (
        "too few coordinates",
        header("axes", 0, "coordinates", to=[1, 2]),
        "field-value",
        "header.axes[0].coordinates",
    ),
    ("coordinates null", header("axes", 0, "coordinates", to=None), "field-type", "header.axes[0].coordinates"),
    (
        "coordinates of 17",
        header("axes", 0, "coordinates", to={"dtype": "F32", "width": 17}),
        "field-value",
        "header.axes[0].coordinates.width",
    ),
    ("an axis in no mode", header("organisation", to=[[0]]), "organisation", "header.organisation"),
    ("an axis twice", header("organisation", to=[[0], [0, 1]]), "organisation", "header.organisation"),
    ("a mode without axes", header("organisation", to=[[0, 1], []]), "field-value", "header.organisation"),
    ("an unknown type", header("dtype", to="float128"), "field-value", "header.dtype"),
    ("an unknown kind", header("kind", to="sound"), "field-value", "header.kind"),
    (
        "an unknown transform",
        header("transform", to={"name": "cube"}),
        "transform-unknown",
        "header.transform.name",
    ),
    (
        "a scale of 0",
        header("transform", to={"name": "log1p", "scale": 0}),
        "field-value",
        "header.transform.scale",
    ),
    ("quality of no level", header("quality", to=[]), "field-value", "header.quality"),
    ("null, and errors", header("quality", 0, "rmse", to=1.0), "field-value", "header.quality[0].snr_db"),
    ("no stages", header("stages", to=[]), "field-value", "header.stages"),
    ("two roots", header(*ROOT, "nodes", to=2), "field-value", "header.stages[0].runs"),
    ("a step of 0", header(*ROOT, "step", to=0), "field-value", "header.stages[0].step"),
    ("a step beyond float32", header(*ROOT, "step", to=1e39), "field-value", "header.stages[0].step"),
    ("a step and bits", header(*ROOT, "bits", to=16), "field-value", "header.stages[0].bits"),
    ("8 bits", header(*ROOT, "bits", to=8), "field-value", "header.stages[0].bits"),
    ("neither step nor bits", header(*ROOT, "step"), "field-value", "header.stages[0].largest"),
    ("an unknown scheme", header(*ROOT, "scheme", to="some"), "field-value", "header.stages[0].scheme"),
    ("other rows", header(*ROOT, "rows", 0, to=5), "row-count", "header.stages[0].rows"),
    ("a writer that is null", header("writer", to=None), "field-type", "header.writer"),
    ("a source that is null", header("source", to=None), "field-type", "header.source"),
    ("a seed that is null", header("seed", to=None), "field-type", "header.seed"),
    ("a unit that is null", header("axes", 0, "unit", to=None), "field-type", "header.axes[0].unit"),
    ("a run without nodes", header(*ROOT, "runs", to=[[0, 4, 0, 0, 0, 0]]), "field-value", "header.stages[0].runs"),
    ("too few counts", header(*ROOT, "runs", 0, to=[1, 4]), "field-value", "header.stages[0].runs[0]"),
]


def field_cases() -> Cases:
    """Fields of wrong types and values."""
    return [case(name, SMALL, [edit], reason, where) for name, edit, reason, where in BAD_FIELDS]


def limit_cases() -> Cases:
    """What a file may declare."""
    cost = {"rank": 1, "level_cost": 0}
    return [
        case("modes", SMALL, [], "order-limit", "header.organisation", order=1),
        case("axes", SMALL, [], "axes-limit", "header.axes", axes=1),
        case("elements", SMALL, [], "elements-limit", "header.axes", elements=11),
        case("stages", MERGED, [], "levels-limit", "header.stages", levels=2),
        case("nodes", OWN, [], "nodes-limit", "header.stages", nodes=2),
        case("clusters", MERGED, [], "clusters-limit", None, clusters=1),
        case("mixture", OWN, [], "mixture-limit", None, mixture=1),
        case("rank", SMALL, [header("stages", 0, "largest", 2, 0, to=1025)], "rank-limit", "header.stages[0].largest"),
        case("cost", OWN, [], "level-cost-limit", None, level_cost=cost["level_cost"]),
        case("memory", SMALL, [header("stages", 0, "runs", 0, 3, to=2**31)], "widened-limit", "header.stages"),
    ]


def _started(clusters: int, mixture: int = 1) -> Encoder:
    """The code of the node of the small file up to its C and K of mode 0."""
    coder = Encoder()
    coder.bit(("kind", 0, 0), 1)
    coder.bit(("undecomposed", 0, 0), 0)
    code_integer(coder, ("C", 0), clusters - 1)
    if clusters > 1:
        code_integer(coder, ("K", 0), mixture - 1)
    return coder


def _finished(coder: Encoder) -> None:
    """The shape after that: R = 1, mode 1 undecomposed."""
    code_integer(coder, ("R", 0, 0), 0)
    coder.bit(("undecomposed", 1, 0), 1)


def _run_case(name: str, coder: Encoder, largest: list[list[int]], reason: str) -> dict[str, Any]:
    """The small file with another code, and room for what that asks for."""
    data = coder.finish() + bytes(8)
    # Their lengths go together, so both are changed at once.
    changes = [
        header("stages", 0, "runs", 0, to=[1, len(data), 9, 99, 99, 0]),
        header("stages", 0, "largest", to=largest),
    ]
    return case(name, SMALL, [{"op": "rewrite", "header": changes, "hex": data.hex()}], reason, "stages[0].runs[0]")


def _labels(places: list[int], clusters: int, told: int) -> Callable[[], Encoder]:
    def make() -> Encoder:
        coder = _started(clusters, len(places))
        _finished(coder)
        for j, label in enumerate(places):
            code_label(coder, ("memb", 0, "label", j), told, label)
        return coder

    return make


def run_cases() -> Cases:
    """Codes that mean what cannot be."""
    wide = [[3, 1], [3, 0], [2, 3]]
    endless = _started(1)
    for n in range(32):
        endless.bit((("R", 0, 0), "length", n), 1)
    shallow = _started(2, 3)
    narrow = _started(2)
    return [
        _run_case("an endless number", endless, wide, "code-range"),
        _run_case("K above C", _with_end(shallow), wide, "node-shape"),
        _run_case("C above the largest", _with_end(narrow), [[1, 1], [1, 0], [2, 3]], "level-bounds"),
        _run_case("a label beyond C", _labels([3], 3, 4)(), wide, "cluster-range"),
        _run_case("a label twice", _labels([1, 1], 3, 3)(), wide, "cluster-order"),
        case("a cell too many", SMALL, [header("stages", 0, "runs", 0, 2, to=2)], "run-count", "stages[0].runs[0]"),
        case(
            "a number too few",
            SMALL,
            [header("stages", 0, "runs", 0, 4, to=parts_of(SMALL).header["stages"][0]["runs"][0][4] - 1)],
            "run-count",
            "stages[0].runs[0]",
        ),
        case(
            "a larger C in the header",
            SMALL,
            [header("stages", 0, "largest", 0, 0, to=2)],
            "level-bounds",
            "stages[0].largest[0]",
        ),
        case(
            "an end that is none",
            SMALL,
            [{"op": "section", "number": 0, "at": -1, "hex": "55"}],
            "code-end",
            "stages[0].runs[0]",
        ),
        *_tree_cases(),
        *_number_cases(),
    ]


def _with_end(coder: Encoder) -> Encoder:
    _finished(coder)
    return coder


def _tree_cases() -> Cases:
    stages = parts_of(HALF).header["stages"]
    nodes, rows = stages[1]["nodes"], stages[1]["rows"]
    more = [
        header("stages", 1, "nodes", to=nodes + 1),
        header("stages", 1, "runs", 0, 0, to=stages[1]["runs"][0][0] + 1),
    ]
    return [
        case("a node too many", HALF, more, "child-count", "stages[0]"),
        case("rows too many", HALF, [header("stages", 1, "rows", 0, to=rows[0] + 1)], "row-count", "stages[0]"),
    ]


def _number_cases() -> Cases:
    parts = parts_of(HALF)
    half = next(t for t, stage in enumerate(parts.header["stages"]) if "bits" in stage)
    number = sum(len(stage["runs"]) for stage in parts.header["stages"][:half])
    return [
        case(
            "an infinite scale", HALF, [{"op": "section", "number": number, "at": -4, "hex": "0000807f"}], "not-finite"
        ),
        case("a huge scale", HALF, [{"op": "section", "number": number, "at": -4, "hex": "ffff7f7f"}], "value-range"),
        case(
            "a coordinate that is NaN",
            MERGED,
            [{"op": "section", "number": 0, "at": 0, "hex": "0000c07f"}],
            "not-finite",
            "axes[0].coordinates",
        ),
    ]


def write_corpus() -> None:
    """All cases."""
    cases = [*frame_cases(), *json_cases(), *field_cases(), *limit_cases(), *run_cases()]
    CORPUS.parent.mkdir(exist_ok=True)
    lines = ",\n".join(json.dumps(each, ensure_ascii=False) for each in cases)
    CORPUS.write_text(f'{{"cases": [\n{lines}\n]}}\n', encoding="utf-8")


if __name__ == "__main__":
    write_corpus()
