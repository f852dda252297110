"""Value transforms: back to the source's values, and no value outside the domain goes unnoticed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmkcta.errors import HmkctaError
from hmkcta.render.prelude import TRANSFORM_NUMBERS, shader
from hmkcta.transform import TRANSFORMS, Transform, from_json, parse

ALL = [Transform(), Transform("log1p"), Transform("log1p", 0.25), Transform("asinh", 3.0), Transform("sqrt")]


@pytest.mark.parametrize("transform", ALL, ids=str)
@given(values=st.lists(st.floats(0, 1e6, width=32), min_size=1))
def test_inverse_undoes_forward(transform: Transform, values: list[float]) -> None:
    for dtype, tolerance in ((np.float32, 2e-5), (np.float64, 1e-12)):
        x = np.array(values, dtype)
        back = transform.inverse(transform.forward(x))
        assert back.dtype == dtype
        np.testing.assert_allclose(back, x, rtol=tolerance, atol=tolerance)


def test_known_values() -> None:
    x = np.array([0.0, 1.0, 3.0])
    np.testing.assert_allclose(Transform("log1p", 0.5).forward(x), np.log([1.0, 3.0, 7.0]))
    np.testing.assert_allclose(Transform("asinh", 2.0).forward(-x), -np.arcsinh([0.0, 0.5, 1.5]))
    np.testing.assert_allclose(Transform("sqrt").forward(x), np.sqrt(x))
    np.testing.assert_array_equal(Transform("sqrt").inverse(np.array([-1.0, 2.0])), [0.0, 4.0])
    assert Transform().forward(x) is x


def test_types() -> None:
    assert Transform("sqrt").forward(np.array([4], np.uint8)).dtype == np.float32
    assert Transform("sqrt").forward(np.array([4], np.float16)).dtype == np.float32
    assert Transform("asinh").forward(np.array([4], np.int32)).dtype == np.float64
    assert Transform("log1p", 0.5).forward(np.array([4], np.float32)).dtype == np.float32


def test_signed_values_keep_their_sign() -> None:
    x = np.array([-5.0, -1e-3, 0.0, 1e-3, 5.0])
    transform = Transform("asinh", 0.01)
    np.testing.assert_allclose(transform.inverse(transform.forward(x)), x)


@pytest.mark.parametrize(("name", "values"), [("log1p", [500.0, -500.0]), ("asinh", [500.0, -500.0]), ("sqrt", [1e30])])
def test_a_decoder_never_makes_infinity(name: str, values: list[float]) -> None:
    assert np.isfinite(Transform(name).inverse(np.array(values, np.float32))).all()


def test_float32_does_not_overflow_before_the_scale_is_applied() -> None:
    value, small = np.array([1e29], np.float32), Transform("log1p", 1e-10)
    np.testing.assert_allclose(small.inverse(small.forward(value)), value, rtol=1e-4)
    assert np.isfinite(Transform("asinh", 1e-30).forward(np.array([1e10], np.float32))).all()


@pytest.mark.parametrize(("text", "bad"), [
    ("log1p:0.5", -0.5), ("log1p", -2.0), ("log1p", np.nan), ("asinh", np.inf), ("sqrt", -1e-9), ("sqrt", np.nan),
])
def test_values_outside_the_domain_are_counted_and_the_first_is_named(text: str, bad: float) -> None:
    values = np.ones((2, 3))
    values[0, 2] = values[1, 1] = bad
    with pytest.raises(HmkctaError, match=r"2 outside.* at index \(0, 2\)") as caught:
        parse(text).forward(values)
    assert caught.value.reason == "transform-domain"
    values[:] = 1
    parse(text).forward(values)


@pytest.mark.parametrize("transform", ALL, ids=str)
def test_text_and_json_read_back(transform: Transform) -> None:
    assert parse(str(transform)) == transform
    assert from_json(transform.to_json()) == transform


def test_shaders_undo_every_transform() -> None:
    assert TRANSFORM_NUMBERS.keys() == TRANSFORMS.keys()
    cases = shader("decode").partition("switch TRANSFORM {")[2].partition("default:")[0]
    assert {name for name, number in TRANSFORM_NUMBERS.items() if f"case {number}u:" not in cases} == {"identity"}


@pytest.mark.parametrize(("text", "reason"), [
    ("log2", "unknown-transform"), ("log1p:", "transform-scale"), ("log1p:zero", "transform-scale"),
    ("log1p:0", "transform-scale"), ("log1p:-1", "transform-scale"), ("asinh:nan", "transform-scale"),
    ("asinh:inf", "transform-scale"), ("sqrt:2", "transform-scale"), ("", "unknown-transform"),
])
def test_bad_text_is_refused(text: str, reason: str) -> None:
    with pytest.raises(HmkctaError) as caught:
        parse(text)
    assert caught.value.reason == reason


@pytest.mark.parametrize(("stored", "reason"), [
    ({}, "unknown-transform"), ({"name": 3}, "unknown-transform"), ({"name": "exp"}, "unknown-transform"),
    ({"name": "log1p"}, "transform-fields"), ({"name": "sqrt", "scale": 1.0}, "transform-fields"),
    ({"name": "log1p", "scale": "1"}, "transform-scale"), ({"name": "log1p", "scale": True}, "transform-scale"),
    ({"name": "log1p", "scale": 0.0}, "transform-scale"), ({"name": "identity", "more": 1}, "transform-fields"),
])
def test_bad_json_is_refused(stored: dict[str, Any], reason: str) -> None:
    with pytest.raises(HmkctaError) as caught:
        from_json(stored)
    assert caught.value.reason == reason
