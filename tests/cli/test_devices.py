"""``clgs devices`` against what pyopencl says."""

import json

import pytest

from clgs.opencl.choose import choose_device, form_of, kind_of, list_devices


@pytest.fixture(autouse=True)
def _no_choice(monkeypatch):
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)


def test_json_describes_every_device(output_of):
    devices = json.loads(output_of("devices", "--json"))
    expected = list_devices()
    assert [device["name"] for device in devices] == [d.name.strip() for d in expected]
    assert [device["memory"] for device in devices] == [d.global_mem_size for d in expected]
    (chosen,) = [device for device in devices if device["chosen"]]
    assert expected[chosen["index"]] == choose_device()
    assert [one["kind"] for one in devices] == [kind_of(d, form_of(d)) for d in expected]


@pytest.mark.parametrize("form", ["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
def test_devices_of_a_kind_have_the_same_letter(output_of, monkeypatch, form):
    monkeypatch.setenv("CLGS_SPECIALISATION", form)
    kinds = [one["kind"] for one in json.loads(output_of("devices", "--json"))]
    assert all(f", {form} kernels" in kind for kind in kinds)
    heading, *rows = output_of("devices").splitlines()
    assert heading.split()[-1] == "together"
    letters = [row.split()[-1] for row in rows]
    assert letters[0] == "A"
    assert len(set(zip(kinds, letters, strict=True))) == len(set(kinds)) == len(set(letters))


def test_the_table_has_a_row_a_device_and_one_star(output_of):
    heading, *rows = output_of("devices").splitlines()
    assert heading.split()[:3] == ["index", "type", "name"]
    assert len(rows) == len(list_devices())
    assert sum(row.startswith("*") for row in rows) == 1
