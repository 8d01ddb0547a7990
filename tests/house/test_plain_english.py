"""The checkout is written in words that need no second reading, and the check of that can fail."""

import pytest

from tests.house import plain_english


def test_no_word_needs_a_second_reading():
    assert list(plain_english.found_in([])) == []


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("a.md", "plain\nit lies beside the file", 2),
        ("a.cl", "/* so many */", 1),
        ("a.py", '"""Of a coordinate, its sign."""', 1),
        ("a.py", 'x = 1\n"""With a unit."""', 2),
    ],
)
def test_words_and_docstrings_are_found(name, text, line):
    (found,) = plain_english.complaints(name, text)
    assert found.startswith(f"{name}:{line}: ")
