"""Pictures and depth maps in every form are read as they mean, or their neglect is told."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from gazenerf.viz.check.frames import read_frames
from tests.viz.check.frame_folders import CAMERAS, agrees, first, save, scene, textured


def test_every_mode_of_a_picture_is_read_as_it_means(tmp_path):
    data = scene(tmp_path)
    plain = textured(CAMERAS[0])
    grey = Image.fromarray(plain[..., 0])
    modes = {
        "deep.png": Image.fromarray(plain[..., 0].astype(np.uint16) * 257),
        "grey.png": grey,
        "palette.png": grey.convert("P"),
        "alpha.png": Image.merge("LA", (grey, Image.new("L", grey.size, 255))),
        "print.jpg": Image.fromarray(plain).convert("CMYK"),
    }
    assert modes["deep.png"].mode == "I;16" and modes["palette.png"].mode == "P"
    for name, image in modes.items():
        image.save(tmp_path / name, quality=98)
        save(tmp_path, first(data, file_path=name))
        assert np.abs(read_frames(tmp_path).images[0].astype(int) - plain).mean() < 3.0, name


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_turned_as_exif_says_and_it_is_told(tmp_path, orientation):
    data = scene(tmp_path)
    exif = Image.Exif()
    exif[0x0112] = orientation
    undo = {2: 0, 3: 3, 4: 1, 5: 5, 6: 2, 7: 6, 8: 4}  # the transposition that the viewer's one takes back
    upright = Image.fromarray(textured(CAMERAS[0]))
    stored = upright if orientation == 1 else upright.transpose(Image.Transpose(undo[orientation]))
    stored.save(tmp_path / "turned.jpg", exif=exif, quality=98)
    save(tmp_path, first(data, file_path="turned.jpg"))
    folder = read_frames(tmp_path)
    assert folder.images[0].shape == (32, 40, 3) and agrees(folder, 0)
    assert any("1 picture was turned" in note for note in folder.notes) == (orientation != 1)


def test_pictures_are_not_turned_where_their_camera_says_so(tmp_path):
    data = scene(tmp_path)
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(textured(CAMERAS[0])).save(tmp_path / "kept.jpg", exif=exif, quality=98)
    save(tmp_path, first(data, file_path="kept.jpg"))
    folder = read_frames(tmp_path)
    assert agrees(folder, 0) and any("was not turned" in note for note in folder.notes)


def test_a_picture_in_colours_or_of_eight_bits_is_no_depth(tmp_path):
    data = scene(tmp_path)
    Image.new("L", (40, 32), 9).save(tmp_path / "eight.png")
    Image.new("RGB", (40, 32), "red").save(tmp_path / "colours.png")
    Image.new("P", (40, 32), 3).save(tmp_path / "palette.png")
    for frame, name in zip(data["frames"], ("eight", "colours", "palette"), strict=True):
        frame["depth_file_path"] = f"{name}.png"
    save(tmp_path, data)
    folder = read_frames(tmp_path)
    assert all(frame.depth is None for frame in folder.frames)
    assert any("3 of 3 depth files" in note and "16-bit" in note for note in folder.notes)
