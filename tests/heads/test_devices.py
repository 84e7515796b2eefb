"""Everything a head computes lies on its device; CPU and GPU agree where there is one."""

from __future__ import annotations

import copy
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import bundled_fields, load_field
from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.baked import bake
from gazenerf.heads.head import LEAST_CHUNK, Head
from gazenerf.heads.interface import HeadField
from gazenerf.image_metrics import psnr
from gazenerf.subjects import load_subject
from tests.field_doubles import make_field, make_subject, soft_field, tiny_config
from tests.pretend_device import GPU, OnGPU, move, pretended_gpu

GAZE = Gaze(0.1, -0.2)

FIELDS = {
    "guided": soft_field,
    "published": lambda: make_field(tiny_config(sampler="slabs", merge="max", eyes_box=None)),
    "one stream": lambda: make_field(tiny_config(sampler="slabs", streams="one", merge="max", eyes_box=None)),
}


def everything(head: HeadField) -> dict[str, np.ndarray]:
    """What a head's paths give, as arrays of the CPU."""
    bound, camera = head.at(GAZE), Camera.orbit(yaw=0.3, size=32)
    view, geometry = bound.render(camera, bound.parts), bound.render_geometry(camera, normals=True)
    points = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (200, 3)).astype(np.float32))
    found: dict[str, np.ndarray] = {part: view.images[part] for part in bound.parts}
    assert geometry.normals is not None
    found |= {"opacity": geometry.opacity, "depth": geometry.depth, "normals": geometry.normals}
    density = bound.density(points)
    assert density.device.type == "cpu" and type(density) is torch.Tensor
    return found | {"density": density.numpy(), "background": bound.background}


def assert_close(ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray], atol: float) -> None:
    for name, expected in theirs.items():
        assert np.isfinite(expected).any() and (name == "opacity" or np.nanstd(expected) > 1e-4), name
        np.testing.assert_allclose(ours[name], expected, rtol=1e-4, atol=atol, err_msg=name)


@pytest.mark.filterwarnings("ignore:.*there is no surface")
@pytest.mark.parametrize("name", FIELDS)
def test_nothing_is_made_on_the_cpu_on_the_way(name: str) -> None:
    field = FIELDS[name]()
    subject = make_subject(field.config)
    expected = everything(Head(field, subject, upsampler="reference"))
    with pretended_gpu():
        head = Head(move(copy.deepcopy(field)), subject, precision="float32", upsampler="reference")
        assert head.device == GPU and head.at(GAZE).device == GPU
        found = everything(head)
        slow = head.at(GAZE).render_slow(Camera.neutral(32))
    assert_close(found, expected, 1e-4)
    assert all(isinstance(value, OnGPU) for value in slow.values())


def test_a_bake_stays_on_the_device() -> None:
    field = soft_field()
    subject = make_subject(field.config)
    expected = everything(bake(Head(field, subject, upsampler="reference"), Gaze()))
    with pretended_gpu():
        baked = bake(Head(move(copy.deepcopy(field)), subject, precision="float32", upsampler="reference"), Gaze())
        assert baked.device == GPU
        for held in (baked.baked.density.raw, baked.baked.density.skip, baked.baked.features.table):
            assert isinstance(held, OnGPU)
        found = everything(baked)
        baked.at(Gaze()).render(Camera.neutral(32))
    assert_close(found, expected, 1e-4)


def test_the_pretence_notices_what_a_gpu_would() -> None:
    with pretended_gpu():
        there = torch.ones(3, device=GPU)
        assert there.device == GPU and isinstance(there + 1, OnGPU) and isinstance(there * torch.tensor(2.0), OnGPU)
        assert isinstance(torch.zeros(2).to(GPU), OnGPU) and isinstance(torch.zeros(2).to(there), OnGPU)
        assert type(there.cpu()) is torch.Tensor and type(there.to("cpu")) is torch.Tensor
        with pytest.raises(RuntimeError, match="add: a CPU tensor"):
            there + torch.ones(3)
        with pytest.raises(RuntimeError, match="a CPU tensor"):
            torch.cat([there, torch.zeros(1)])
        with pytest.raises(TypeError, match="numpy"):
            there.numpy()


def test_points_of_any_device_are_answered_there() -> None:
    field = soft_field()
    with pretended_gpu():
        bound = Head(move(field), make_subject(field.config), precision="float32", upsampler="reference").at(GAZE)
        points = torch.rand(10, 3)
        assert type(bound.density(points)) is torch.Tensor and isinstance(bound.density(points.to(GPU)), OnGPU)
        assert type(bound.normals(points)) is torch.Tensor and isinstance(bound.normals(points.to(GPU)), OnGPU)


class SmallMemory:
    """Runs out of memory for more points than fit."""

    def __init__(self, field: TwoStreamField, most: int) -> None:
        self.field, self.most, self.asked, self._query = field, most, [], field.query

    def query(self, name: str, points: torch.Tensor, *args: object, **options: object) -> object:
        count = points.shape[:-1].numel()
        self.asked.append(count)
        if count > self.most:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return self._query(name, points, *args, **options)  # type: ignore[arg-type]


def test_short_memory_means_fewer_points_at_once_and_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    field = soft_field()
    head = Head(field, make_subject(field.config))
    camera = Camera.neutral(64)
    expected = head.at(GAZE).render(camera).image
    memory = SmallMemory(field, 3000)
    monkeypatch.setattr(field, "query", memory.query)
    with pytest.warns(UserWarning, match="memory is short; going on with fewer points") as said:
        found = head.at(GAZE).render(camera).image
        bound = head.at(GAZE)
        bound.render_geometry(camera)
        bound.density(torch.zeros(9000, 3))
    assert len(said) == 1 and head.chunk == LEAST_CHUNK and max(memory.asked) > 3000
    assert psnr(found, expected) > 80.0
    memory.most = 10
    with pytest.raises(UserError, match="too little free memory"):
        head.at(GAZE).render(camera)


def test_impossible_devices_are_one_line() -> None:
    field = soft_field()
    with pytest.raises(UserError, match="unknown device 'tpu'; choose auto, cpu, cuda"):
        Head(field, make_subject(field.config), device="tpu")
    with pytest.raises(UserError, match="unknown precision 'int4'"):
        Head(field, make_subject(field.config), precision="int4")
    if not torch.cuda.is_available():
        with pytest.raises(UserError, match=r"no CUDA device .*; use --device cpu"):
            Head(field, make_subject(field.config), device="cuda")


@pytest.fixture
def bundled() -> Path:
    return bundled_fields()["small"]


def test_half_precision_is_close_on_the_bundled_field(bundled: Path) -> None:
    """What a GPU computes in by default, on the CPU."""
    subject, camera = load_subject("ada"), Camera.orbit(yaw=0.4, size=128)
    kinds = ("float32", "float16")
    views = [Head(load_field(bundled), subject, device="cpu", precision=kind).at(GAZE) for kind in kinds]
    exact, half = (view.render(camera, ("head", "eyes")) for view in views)
    for part in ("head", "eyes"):
        assert psnr(half.images[part], exact.images[part]) > 45.0
    a, b = (view.render_geometry(camera).depth for view in views)
    both = np.isfinite(a) & np.isfinite(b)
    assert both.sum() > 2000 and np.median(np.abs(a - b)[both]) < 1e-3  # 0.1 mm
    assert np.mean(np.isfinite(a) != np.isfinite(b)) < 2e-3


def test_a_bake_in_half_precision_is_close_on_the_bundled_field(bundled: Path) -> None:
    subject, camera = load_subject("ada"), Camera.orbit(yaw=0.4, size=128)
    exact, half = (Head(load_field(bundled), subject, device="cpu", precision=kind) for kind in ("float32", "float16"))
    assert psnr(bake(half, Gaze()).at(GAZE).render(camera).image, exact.at(GAZE).render(camera).image) > 35.0


@pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch sees no CUDA device")
def test_the_gpu_draws_the_same_head(bundled: Path) -> None:
    subject, camera = load_subject("ada"), Camera.orbit(yaw=0.4, size=256)
    here = Head(load_field(bundled), subject, device="cpu").at(GAZE)
    exact, depth = here.render(camera).image, here.render_geometry(camera).depth
    for precision, least, most in (("float32", 55.0, 1e-4), ("auto", 42.0, 2e-3)):
        head = Head(load_field(bundled), subject, device="cuda", precision=precision)
        assert head.device.type == "cuda"
        assert psnr(head.at(GAZE).render(camera).image, exact) > least
        found = head.at(GAZE).render_geometry(camera).depth
        both = np.isfinite(found) & np.isfinite(depth)
        assert np.mean(both != np.isfinite(depth)) < 5e-3
        assert np.median(np.abs(found - depth)[both]) < most
        baked = bake(head, Gaze())
        assert psnr(baked.at(GAZE).render(camera).image, exact) > 38.0
        cameras = [Camera.orbit(yaw=0.1 * i, size=256) for i in range(5)]
        for some in (head, baked):
            views = [(some.at(GAZE), camera) for camera in cameras]
            for view, (bound, one) in zip(some.frames.render(views), views, strict=True):
                assert psnr(view.image, bound.render(one).image) > 45.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert head.chunk > 2**16  # memory did not run short
