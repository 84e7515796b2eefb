"""What a training run leaves in its folder: its log, previews of held-out captures, and a state to go on from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.files import whole_file
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import TrainConfig
from gazenerf.training.forward import render_batch
from gazenerf.training.runtime import Runtime


def read_state(path: Path) -> dict[str, Any]:
    """The state file of a run.

    Raises:
        UserError: it is not there or damaged.
    """
    if not path.is_file():
        raise UserError(f"nothing to resume: {path} is not there; train without --resume first")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise UserError(f"cannot resume from {path}: {error}") from error


def append_row(path: Path, row: dict[str, Any]) -> None:
    """Write one more line of JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps({key: round(v, 6) if isinstance(v, float) else v for key, v in row.items()}) + "\n")


def forget_after(path: Path, step: int) -> None:
    """Drop the log's rows beyond a step, which a resumed run writes again."""
    if path.is_file():
        rows = [line for line in path.read_text().splitlines() if json.loads(line)["step"] <= step]
        with whole_file(path) as temporary:
            temporary.write_text("".join(f"{row}\n" for row in rows))


@torch.no_grad()
def write_preview(
    model: TwoStreamField, watch: BatchMaker, config: TrainConfig, runtime: Runtime, path: Path, count: int = 6
) -> dict[str, float]:
    """Write captured, merged and face-only pictures side by side; PSNR inside heads and eyes, dB."""
    model.eval()
    rows, head_error, eyes_error = [], [], []
    chosen = np.linspace(0, len(watch) - 1, min(count, len(watch))).astype(int)
    for index in chosen.tolist():
        batch = watch.batch([index], np.random.default_rng(0)).to(runtime.device)
        with runtime.autocast():
            render = render_batch(
                model, batch, shell=config.shell, samples=config.shell_samples, jitter=False, face_image=True,
                geometry=False,
            )  # fmt: skip
        error = ((render.image - batch.image) ** 2).mean(1)
        head_error.append(float(error[batch.parts > 0].mean()))
        if bool((batch.parts >= 2).any()):
            eyes_error.append(float(error[batch.parts >= 2].mean()))
        tiles = [batch.image, render.image]
        if render.face_image is not None:
            tiles.append(render.face_image)
        rows.append(torch.cat(tiles, dim=3)[0])
    sheet = torch.cat(rows, dim=1).clamp(0, 1).permute(1, 2, 0).float().cpu().numpy()
    with whole_file(path) as temporary:
        Image.fromarray((sheet * 255 + 0.5).astype(np.uint8)).save(temporary)
    psnr = {"head": -10.0 * float(np.log10(np.mean(head_error)))}
    if eyes_error:
        psnr["eyes"] = -10.0 * float(np.log10(np.mean(eyes_error)))
    return {name: round(value, 2) for name, value in psnr.items()}
