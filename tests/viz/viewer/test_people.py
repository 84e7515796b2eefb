"""Subjects changed by sliders, drawn by chance, and read from strangers' files."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.head_model import load_head_model
from gazenerf.subjects import MAX_SUBJECT_BYTES, load_subject
from gazenerf.viz.viewer.people import code_sliders, moved, random_person, read_upload, subject_file

ADA = load_subject("ada")
SLIDERS = code_sliders(ADA.codes.sizes)
BY_LABEL = {slider.label: slider for slider in SLIDERS}


def test_expressions_are_called_by_their_arkit_names_and_the_gaze_keeps_its_own():
    names = {slider.label for slider in SLIDERS if slider.code == "expression"}
    assert {"jawOpen", "eyeBlinkLeft"} <= names <= set(load_head_model().expression_names)
    assert not any(name.startswith("eyeLook") for name in names)


def test_the_strongest_shapes_come_first():
    reach = np.abs(load_head_model().identity).sum(axis=(1, 2))
    chosen = [slider.index for slider in SLIDERS if slider.code == "identity"]
    assert chosen[0] == reach.argmax() and reach[chosen].min() >= np.delete(reach, chosen).max()


@pytest.mark.parametrize("label", ["jawOpen", "shape 1", "iris blue", "light from above"])
def test_a_slider_moves_its_own_number_and_the_reference_with_it(label):
    slider = BY_LABEL[label]
    after = moved(ADA, {slider: slider.value(ADA.codes) + 0.5})
    assert slider.value(after.codes) == pytest.approx(slider.value(ADA.codes) + 0.5, abs=1e-6)
    assert after.head_codes is not None
    for name in ("identity", "expression", "texture", "illumination"):
        change = getattr(after.codes, name) - getattr(ADA.codes, name)
        assert np.count_nonzero(change) == (0 if name != slider.code else 3 if name == "illumination" else 1)
        np.testing.assert_allclose(getattr(after.head_codes, name) - getattr(ADA.head_codes, name), change, atol=1e-6)


def test_sliders_where_they_were_change_nothing():
    assert moved(ADA, {slider: slider.value(ADA.codes) for slider in SLIDERS}) is ADA


def test_a_changed_person_is_nobody_that_training_saw():
    assert ADA.provenance["trained"] is not None
    after = moved(ADA, {BY_LABEL["jawOpen"]: 0.7})
    assert "trained" not in after.provenance and ADA.provenance["trained"] is not None


def test_a_slider_that_is_not_a_number_is_refused():
    with pytest.raises(ValueError, match="jawOpen"):
        moved(ADA, {BY_LABEL["jawOpen"]: float("nan")})


def test_codes_of_another_model_get_sliders_too():
    sliders = code_sliders((3, 79, 4, 27))
    assert [slider.index for slider in sliders if slider.code == "identity"] == [0, 1, 2]
    assert {slider.code for slider in code_sliders((3, 5, 4, 9))} == {"identity", "expression", "texture"}


def test_the_same_seed_is_the_same_person():
    first, again, other = (random_person(seed, ADA.codes.sizes) for seed in (7, 7, 8))
    assert np.array_equal(first.codes.identity, again.codes.identity)
    assert not np.array_equal(first.codes.identity, other.codes.identity)
    with pytest.raises(UserError, match="other codes"):
        random_person(7, (1, 2, 3, 27))


def test_cuts_of_hair_have_sliders_where_the_field_takes_them():
    sliders = {slider.label: slider for slider in code_sliders(ADA.codes.sizes, hair=True) if slider.code == "hair"}
    assert tuple(sliders) == load_head_model().hair_names and not any(slider.code == "hair" for slider in SLIDERS)
    assert not any(slider.code == "hair" for slider in code_sliders((3, 79, 4, 27), hair=True))
    bob = sliders["bob"]
    assert ADA.codes.hair.size == 0 and bob.value(ADA.codes) == 0.0
    after = moved(ADA, {bob: 0.8})
    assert after.head_codes is not None
    for codes in (after.codes, after.head_codes):
        assert bob.value(codes) == pytest.approx(0.8) and np.count_nonzero(codes.hair) == 1
    plain, haired = random_person(4, ADA.codes.sizes), [random_person(k, ADA.codes.sizes, hair=True) for k in range(9)]
    assert plain.codes.hair.size == 0 and any(person.codes.hair.any() for person in haired)


def test_sliders_show_the_digits_that_were_given():
    jana = load_subject("jana")
    parting = next(s for s in code_sliders(jana.codes.sizes, hair=True) if s.label == "parting")
    assert parting.value(parting.set(jana.codes, 0.4)) == 0.4  # and not 0.4000000059604645


def test_what_is_saved_is_read_back():
    changed = replace(moved(ADA, {BY_LABEL["jawOpen"]: 0.7}), name="eve's <b>sister</b>")
    found = read_upload("mine.safetensors", subject_file(changed))
    assert found.name == changed.name
    assert np.array_equal(found.codes.expression, changed.codes.expression)


@pytest.mark.parametrize(
    "content",
    [b"", b"not a subject", pickle.dumps({"codes": 1}), b"\xff" * 64, subject_file(ADA)[:-40]],
    ids=["empty", "text", "pickle", "noise", "cut"],
)
def test_files_that_are_no_subject_are_refused_by_the_name_that_the_visitor_gave(content):
    with pytest.raises(UserError, match=r"mine\.safetensors") as caught:
        read_upload("mine.safetensors", content)
    assert "/tmp" not in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_that_is_too_large_is_not_even_written(monkeypatch):
    monkeypatch.setattr("gazenerf.viz.viewer.people.tempfile.TemporaryDirectory", None)
    with pytest.raises(UserError, match="larger than a subject"):
        read_upload("mine.safetensors", bytes(MAX_SUBJECT_BYTES + 1))


def test_codes_that_are_not_finite_are_refused():
    content = bytearray(subject_file(ADA))
    content[-4:] = np.float32(np.nan).tobytes()
    with pytest.raises(UserError, match="NaN"):
        read_upload("mine.safetensors", bytes(content))
