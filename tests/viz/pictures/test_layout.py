import numpy as np
import pytest

from gazenerf.viz.pictures.layout import GAP, draw_label, grid_shape, grid_size, table, tile


def flat(value: float, height: int = 60, width: int = 80) -> np.ndarray:
    return np.full((height, width, 3), value, dtype=np.float32)


@pytest.mark.parametrize(
    ("count", "shape"), [(1, (1, 1)), (2, (1, 2)), (3, (1, 3)), (4, (2, 2)), (5, (2, 3)), (6, (2, 3)), (7, (2, 4))]
)
def test_grids(count, shape):
    assert grid_shape(count) == shape


def test_a_single_tile_is_the_picture_itself():
    picture = np.random.default_rng(0).random((10, 12, 3))
    np.testing.assert_array_equal(tile({"image": picture}), np.round(picture * 255).astype(np.uint8))


def test_tiles_lie_row_by_row_where_the_size_says():
    tiles = {str(index): flat(index / 10) for index in range(5)}
    canvas = tile(tiles, labels=False)
    assert (canvas.shape[1], canvas.shape[0]) == grid_size(5, 80, 60) == (3 * 80 + 2 * GAP, 2 * 60 + GAP)
    for index in range(5):
        row, column = divmod(index, 3)
        y, x = row * (60 + GAP), column * (80 + GAP)
        assert (canvas[y : y + 60, x : x + 80] == round(index / 10 * 255)).all()


@pytest.mark.parametrize("count", range(1, 8))
def test_even_tiles_make_even_frames(count):
    assert not any(side % 2 for side in grid_size(count, 64, 48))


def test_labels_are_small_and_different():
    plain = tile({"a": flat(0.5), "b": flat(0.5)}, labels=False)
    named = tile({"depth": flat(0.5), "opacity": flat(0.5)})
    changed = (plain != named).any(axis=-1)
    assert 0.01 < changed.mean() < 0.25
    assert not changed[:30].any()
    assert (named[:, :80] != named[:, 80 + GAP :]).any()


def test_label_text_is_legible():
    drawn = draw_label(np.full((128, 128, 3), 255, np.uint8), "face")
    assert drawn.min() < 120 and (drawn[100:] > 230).any()


def test_tables_hold_every_picture_under_its_label():
    rows = [[flat(0.1), flat(0.2)], [flat(0.3), flat(0.4)], [flat(0.5), flat(0.6)]]
    canvas = table(rows, ["+10°", "0°", "-10°"], ["-20°", "+20°"], row_title="pitch", column_title="yaw")
    left, top = canvas.shape[1] - (2 * 80 + 2 * GAP), canvas.shape[0] - (3 * 60 + 3 * GAP)
    assert left > 20 and top > 20
    for i, row in enumerate(rows):
        for j, picture in enumerate(row):
            y, x = top + i * (60 + GAP), left + j * (80 + GAP)
            assert (canvas[y : y + 60, x : x + 80] == np.round(picture[0, 0, 0] * 255)).all()
    assert canvas[:top].max() > 150 and canvas[:, :left].max() > 150  # something is written


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="one size"):
        tile({"a": flat(0), "b": flat(0, 10, 10)})
    with pytest.raises(ValueError, match="one label"):
        table([[flat(0)]], ["a"], ["b", "c"])
    with pytest.raises(ValueError, match="one size"):
        table([[flat(0), flat(0, 10, 10)]], ["a"], ["b", "c"])
    with pytest.raises(ValueError, match="NaN"):
        tile({"a": flat(np.nan)})
