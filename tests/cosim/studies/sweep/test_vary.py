"""Cases from what users write: every value exactly as written, all combinations, and clear errors."""

from __future__ import annotations

import math
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.studies.sweep.cases import Span, as_cases, make_cases, parse_values, parse_vary, read_cases

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(FINITE, min_size=1, max_size=5))
def test_lists_of_numbers_read_back_exactly(values: list[float]) -> None:
    """The shortest texts of numbers are these numbers again."""
    assert parse_values(",".join(map(repr, values)), "key") == values


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.integers(2, 50))
def test_ranges_have_their_ends_and_equal_steps(low: float, high: float, count: int) -> None:
    """Both ends to the last bit, and steps that differ by rounding alone."""
    values = parse_values(f"{low!r}:{high!r}:{count}", "key")
    assert isinstance(values, list)
    assert len(values) == count
    assert (values[0], values[-1]) == (low, high)
    step = (high - low) / (count - 1)
    assert all(math.isclose(b - a, step, rel_tol=1e-6, abs_tol=1e-8) for a, b in pairwise(values))


@given(st.integers(-50, 50), st.integers(1, 9), st.integers(2, 9))
def test_whole_ranges_are_whole_numbers(low: int, step: int, count: int) -> None:
    """Keys such as numbers of modes take no 1.0."""
    values = parse_values(f"{low}:{low + step * (count - 1)}:{count}", "key")
    assert values == list(range(low, low + step * count, step))
    assert all(type(each) is int for each in values)


@given(
    st.lists(
        st.text(st.characters(categories=["L", "N"], include_characters="-_ ,'[{"), min_size=1), min_size=1, max_size=4
    )
)
def test_quoted_texts_may_have_any_signs(texts: list[str]) -> None:
    """Commas, brackets and apostrophes inside quotes divide nothing."""
    assert parse_values(",".join(f'"{each}"' for each in texts), "key") == texts


def test_kinds_of_values() -> None:
    """TOML values, and texts without quotes."""
    assert parse_vary("a.b=poly7, bang-bang") == ("a.b", ["poly7", "bang-bang"])
    assert parse_vary("a=true,1,2.5,1e-3") == ("a", [True, 1, 2.5, 1e-3])
    assert parse_vary("a=[0.0, -9.81],[0.0, 0.0]") == ("a", [[0.0, -9.81], [0.0, 0.0]])
    assert parse_vary('a={ kind = "poly7" },{ kind = "trapezoidal", ramp = 0.25 }')[1] == [
        {"kind": "poly7"},
        {"kind": "trapezoidal", "ramp": 0.25},
    ]
    assert parse_vary("a=0:8") == ("a", Span(0, 8))
    assert parse_vary("source=mine:Controller") == ("source", ["mine:Controller"])


@pytest.mark.parametrize(
    "option",
    [
        *("payload.mass", "=1", "a=", "a=1,,2", "a=[1", "a='x", "a=[1}"),
        *("a=0:8:1", "a=0:8:2.5", "a=0:nan:3", "a=0:inf", "a=0:1:99999999999"),
    ],
)
def test_other_forms_are_errors(option: str) -> None:
    """An error instead of a guess."""
    with pytest.raises(InputError):
        parse_vary(option)


def test_grids_have_all_combinations_the_last_key_fastest() -> None:
    """In the order of nested loops; values that are there twice once, with a note."""
    cases, notes = make_cases({"a": [1, 2, 1], "b": ["x", "y"], "c": [0.5]})
    assert cases.rows == list(product([1, 2], ["x", "y"], [0.5]))
    assert notes == ["`a`: 1 of 3 values repeat others, each is simulated once"]
    with pytest.raises(InputError, match="is an interval"):
        make_cases({"a": Span(0.0, 1.0)})
    with pytest.raises(InputError, match="something to vary"):
        make_cases({})


@pytest.mark.parametrize(("sample", "count"), [("lhs:50", 50), ("sobol:64", 64)])
def test_samples_fill_every_interval(sample: str, count: int) -> None:
    """One value in each of N equal parts, whole numbers and lists evenly, and the same again for the same seed."""
    varied = {"a": Span(2.0, 4.0), "n": Span(0, 1), "kind": ["x", "y"]}
    cases, same, other = (make_cases(varied, sample, seed)[0] for seed in (1, 1, 2))
    rows = cases.rows
    assert rows == same.rows != other.rows
    assert len(rows) == count
    assert sorted(int((row[0] - 2.0) / 2.0 * count) for row in rows) == list(range(count))
    for place, values in ((1, (0, 1)), (2, ("x", "y"))):
        assert [sum(row[place] == value for row in rows) for value in values] == [count // 2, count // 2]


@pytest.mark.parametrize("sample", ["lhs", "lhs:0", "sobol:100", "grid:10", "lhs:1.5"])
def test_wrong_samples_are_errors(sample: str) -> None:
    """Sobol points need a power of two; the message gives the nearest."""
    with pytest.raises(InputError, match=r"sobol:128|lhs:N"):
        make_cases({"a": Span(0.0, 1.0)}, sample)


def test_cases_from_files(tmp_path: Path) -> None:
    """Units in the heading, empty cells, repeated lines."""
    path = tmp_path / "cases.csv"
    path.write_text(
        'payload.mass [kg],controller[0].sample_time,effects.gravity\n1,,"[0.0, 0.0]"\n2.5,1e-3,\n1,,"[0.0, 0.0]"\n'
    )
    cases, notes = read_cases(path)
    assert cases.keys == ("payload.mass", "controller[0].sample_time", "effects.gravity")
    assert [*map(cases.changes, range(len(cases)))] == [
        {"payload.mass": 1, "effects.gravity": [0.0, 0.0]},
        {"payload.mass": 2.5, "controller[0].sample_time": 1e-3},
    ]
    assert len(notes) == 1
    for text, message in (("", "no cases"), ("a,b\n1\n", "1 cells"), ("a,a\n1,2\n", "there twice")):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_cases(path)
    with pytest.raises(InputError, match="No such file"):
        read_cases(tmp_path / "none.csv")


def test_cases_from_python() -> None:
    """Mappings, arrays and lists of changes."""
    assert len(as_cases({"a": np.linspace(0.0, 1.0, 3), "b": "1,2"})) == 6
    assert type(as_cases({"a": np.arange(2)}).rows[1][0]) is int
    cases = as_cases([{"a": 1}, {"b": 2.0}])
    assert [*map(cases.changes, range(2))] == [{"a": 1}, {"b": 2.0}]
    assert len(as_cases({"a": (0.0, 1.0)}, "lhs:7")) == 7
    with pytest.raises(InputError, match="a dict from keys"):
        as_cases(5)
