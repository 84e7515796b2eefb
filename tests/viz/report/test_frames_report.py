"""The page on frames of another program."""

from __future__ import annotations

import html
import json
import re

import numpy as np
import pytest

from gazenerf.geometry import Camera
from gazenerf.viz.check.frames import Frame, FrameFolder
from gazenerf.viz.check.frames_check import FramesResult, check_frames
from gazenerf.viz.report.frames_report import write_frames_report
from tests.textured_double import TexturedField


@pytest.fixture(scope="module")
def result() -> FramesResult:
    field = TexturedField()
    frames = []
    for i, yaw in enumerate(range(-20, 21, 5)):
        camera = Camera.orbit(np.deg2rad(yaw), size=96)
        picture = np.round(255 * field.render(camera).image).astype(np.uint8)
        frames.append(Frame(f"<b>{i}</b>.png", camera, picture, field.render_geometry(camera).depth))
    return check_frames(FrameFolder(tuple(frames), 30, ("9 of 30 frames were used.",)), name="<u>folder</u>", sfm=False)


def test_everything_that_was_measured_is_shown_and_names_are_escaped(result, tmp_path):
    page, numbers = write_frames_report(result, tmp_path)
    text = page.read_text()
    markup = re.sub(r"base64,[A-Za-z0-9+/=]+", "base64,", text)
    assert not re.search(r"https?:|url\(|<link|@import|src=[\"'](?!data:)|href=[\"'](?!#)|<u>|<b>\d", markup)
    for said in (
        "&lt;u&gt;folder",
        "Every metric",
        "9 of 30 frames",
        "Epipolar-plane image",
        "warped onto it",
        "structure from",
    ):
        assert said in text, said
    assert markup.count('<input type="range"') == 1
    assert markup.index("<input") < markup.index("<nav"), "the pair that agrees least is among the first pictures"
    distances = [float(x) for x in re.findall(r"<figcaption>[^<]*matches, ([\d.]+) px from", text)]
    assert len(distances) == 4 and distances == sorted(distances, reverse=True), "worst pair first"
    data = json.loads(numbers.read_text())
    assert data["definitions"] == "gazenerf-frames-1" and data["versions"]["gazenerf"]


def test_a_folder_without_depth_says_so_on_the_page(result, tmp_path):
    bare = tuple(Frame(frame.name, frame.camera, frame.image) for frame in result.frames[:3])
    page, _ = write_frames_report(check_frames(FrameFolder(bare, 3), sfm=False), tmp_path)
    text = page.read_text()
    assert "depth reprojection and warps: no frame has a depth_file_path" in text
    assert "epipolar-plane image: the frames are no orbit" in text and '<input type="range"' not in text
    assert text.index("The two frames that agree least") < text.index("<nav"), "matches stand in for a warp"


def test_one_sentence_answers_the_title_and_every_metric_is_explained(result, tmp_path):
    text = write_frames_report(result, tmp_path)[0].read_text()
    (sentence,) = re.findall(r'<p class="answer \w+">([^<]+)</p>', text)
    assert re.match(r"(Yes|Nearly|No): ", sentence) and sentence.count(".") == 1
    for metric in result.metrics:
        assert metric.definition.meaning and metric.definition.meaning in html.unescape(text), metric.definition.name
        if metric.verdict in ("warn", "fail"):
            assert metric.definition.advice in html.unescape(text), metric.definition.name
