"""Redirected pictures say so in every format, keep what is still true of the photograph, and nothing else."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import ExifTags, Image

from gazenerf.errors import UserError
from gazenerf.photographs.marking import ALTERED, SOURCE_TYPE, write_altered

ASKED = "requested gaze: pitch 3, yaw -4 degrees & head frame"
PIXELS = np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)


@pytest.fixture
def photograph(tmp_path):
    """Taken upside down by a camera that says when, where and by whom."""
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation], exif[ExifTags.Base.Make], exif[ExifTags.Base.Software] = 3, "Camera", "Other 1"
    exif[ExifTags.Base.ImageDescription] = "on the beach"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] = "2020:01:02 03:04:05"
    exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSLatitudeRef] = "N"
    Image.fromarray(PIXELS).save(tmp_path / "taken.jpg", exif=exif)
    return tmp_path / "taken.jpg"


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_the_mark_is_in_xmp_and_exif(tmp_path, photograph, suffix):
    path = tmp_path / f"new{suffix}"
    write_altered(path, PIXELS, photograph, ASKED)
    with Image.open(path) as image:
        packet = image.info["xmp"]
        exif = image.getexif()
        text = getattr(image, "text", {})
    xmp = {element.tag.rpartition("}")[2]: element.text for element in ElementTree.fromstring(packet).iter()}
    assert xmp["CreatorTool"].startswith("gazenerf ") and xmp["DigitalSourceType"] == SOURCE_TYPE
    assert xmp["RequestedGaze"] == ASKED and xmp["li"] == ALTERED
    assert exif[ExifTags.Base.Software] == xmp["CreatorTool"]
    assert exif[ExifTags.Base.ImageDescription] == f"{ALTERED}; {ASKED}"
    assert exif[ExifTags.Base.Make] == "Camera" and ExifTags.Base.Orientation not in exif
    assert exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] == "2020:01:02 03:04:05"
    assert exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSLatitudeRef] == "N"
    if suffix == ".png":
        assert text["Comment"] == f"{ALTERED}; {ASKED}" and text["Software"] == xmp["CreatorTool"]
        np.testing.assert_array_equal(np.asarray(Image.open(path)), PIXELS)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_without_the_mark_nothing_tells(tmp_path, photograph, suffix):
    path = tmp_path / f"new{suffix}"
    write_altered(path, PIXELS, photograph, ASKED, mark=False)
    content = path.read_bytes()
    assert b"gazenerf" not in content and b"altered" not in content
    with Image.open(path) as image:
        assert image.getexif()[ExifTags.Base.ImageDescription] == "on the beach"


@pytest.mark.parametrize("content", [b"Exif\0\0MM\0*\0\0\0\x08\0\x05\x01\x0f\0\x02\xff\xff", b"Exif\0\0nonsense"])
def test_damaged_exif_is_dropped_and_the_mark_written(tmp_path, content):
    Image.fromarray(PIXELS).save(tmp_path / "odd.jpg", exif=content)
    write_altered(tmp_path / "new.jpg", PIXELS, tmp_path / "odd.jpg", ASKED)
    assert dict(Image.open(tmp_path / "new.jpg").getexif())[ExifTags.Base.ImageDescription].startswith(ALTERED)


def test_other_suffixes_are_refused(tmp_path):
    with pytest.raises(UserError, match="cannot write a picture as new"):
        write_altered(tmp_path / "new.gif", PIXELS, None, ASKED)
    assert not list(tmp_path.iterdir())
