"""Photographs in every form that people have them in, and files that are none."""

from __future__ import annotations

import numpy as np
import pytest
import skimage.data
from PIL import Image, ImageCms

from gazenerf.errors import UserError
from gazenerf.photographs.picture import read_grey, read_photograph

PHOTOGRAPH = skimage.data.astronaut()[:128, 160:288]


def same(file, wanted: np.ndarray, tolerance: float = 3.0) -> bool:
    return np.abs(read_photograph(file).astype(int) - wanted).mean() < tolerance


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "CMYK", "L", "P", "I;16"])
def test_every_mode_is_read_as_it_means(tmp_path, mode):
    grey = np.array(Image.fromarray(PHOTOGRAPH).convert("L"))
    wanted = np.repeat(grey[..., None], 3, axis=-1) if mode in ("L", "I;16") else PHOTOGRAPH
    if mode == "I;16":
        image = Image.fromarray(grey.astype(np.uint16) * 257)
    else:
        image = Image.fromarray(PHOTOGRAPH)
        image = image.quantize(256) if mode == "P" else image.convert(mode)
    file = tmp_path / ("a.jpg" if mode == "CMYK" else "a.png")
    image.save(file, quality=98)
    assert Image.open(file).mode == mode and same(file, wanted, 8.0 if mode == "P" else 3.0)


@pytest.mark.parametrize(("orientation", "undo"), [(2, 0), (3, 3), (4, 1), (5, 5), (6, 2), (7, 6), (8, 4)])
def test_it_is_turned_as_exif_says(tmp_path, orientation, undo):
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored = Image.fromarray(PHOTOGRAPH[:100]).transpose(Image.Transpose(undo))
    stored.save(tmp_path / "a.jpg", exif=exif, quality=98)
    assert read_photograph(tmp_path / "a.jpg").shape == (100, 128, 3) and same(tmp_path / "a.jpg", PHOTOGRAPH[:100])


def test_transparent_pixels_are_white(tmp_path):
    image = Image.fromarray(PHOTOGRAPH).convert("RGBA")
    image.putalpha(0)
    image.save(tmp_path / "a.png")
    assert (read_photograph(tmp_path / "a.png") == 255).all()


def test_an_embedded_colour_profile_counts(tmp_path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB"))
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
    image = Image.fromarray(PHOTOGRAPH)
    image.save(tmp_path / "srgb.png", icc_profile=srgb.tobytes())
    assert same(tmp_path / "srgb.png", PHOTOGRAPH, 1.0)
    image.save(tmp_path / "wrong.png", icc_profile=profile.tobytes())  # of another colour space
    image.save(tmp_path / "broken.png", icc_profile=b"no profile at all")
    assert same(tmp_path / "wrong.png", PHOTOGRAPH, 1e-9) and same(tmp_path / "broken.png", PHOTOGRAPH, 1e-9)


def test_fifty_megapixels_are_read(tmp_path):
    Image.new("L", (8165, 6124), 90).save(tmp_path / "large.png")
    assert read_photograph(tmp_path / "large.png").shape == (6124, 8165, 3)


@pytest.mark.parametrize("name", ["text.jpg", "cut.jpg", "cut.png", "tiny.png", "empty.jpg", "absent.jpg", "huge.png"])
def test_what_is_no_photograph_is_refused_in_one_line(tmp_path, name):
    file, whole = tmp_path / name, tmp_path / "whole.jpg"
    Image.fromarray(PHOTOGRAPH).save(whole)
    Image.fromarray(PHOTOGRAPH).save(tmp_path / "whole.png")
    if name == "text.jpg":
        file.write_text("this is text")
    elif name.startswith("cut"):
        data = (tmp_path / f"whole{file.suffix}").read_bytes()
        file.write_bytes(data[: len(data) // 2])
    elif name == "tiny.png":
        Image.new("RGB", (8, 8)).save(file)
    elif name == "empty.jpg":
        file.touch()
    elif name == "huge.png":
        Image.new("1", (9000, 9000)).save(file)
    with pytest.raises(UserError, match=name) as refused:
        read_photograph(file)
    assert "\n" not in str(refused.value)


def test_labels_of_a_palette_picture_are_its_indices(tmp_path):
    labels = np.kron(np.array([[0, 1], [10, 17]], np.uint8), np.ones((16, 16), np.uint8))
    image = Image.fromarray(labels)
    image.putpalette(np.random.default_rng(0).integers(0, 256, 768).astype(np.uint8).tobytes())
    image.save(tmp_path / "palette.png")
    Image.fromarray(labels).save(tmp_path / "grey.png")
    Image.fromarray(labels > 5).save(tmp_path / "bits.png")
    assert (read_grey(tmp_path / "palette.png", indices=True) == labels).all()
    assert (read_grey(tmp_path / "grey.png", indices=True) == labels).all()
    assert (read_grey(tmp_path / "bits.png") == 255 * (labels > 5)).all()
