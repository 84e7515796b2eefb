"""What an experiment is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gazenerf.options import option
from gazenerf.training.estimator_run import NETWORKS

TRAINING, MEASURING, CALIBRATION = "training", "measuring", "calibration"


@dataclass(frozen=True, kw_only=True)
class ExperimentOptions:
    """What is compared on what, and how it is trained.

    Attributes:
        experiment: A name of `gazenerf.experiments.rows.EXPERIMENTS`.
        data: Folder of captures.
        out: Folder of models, pairs, evaluations and tables; experiments in the same folder share them.
        models: Rows; all of the experiment's where empty.
        test: Of `cross`, `NAME=DIR` of other captures.
        dry_run: Nothing is trained, measured or written.
        preset, settings, minutes, held_out, held_out_views, device: As of `gazenerf train`, for every field.
        sted_settings: As `settings`, for the STED.
        initial: Of `pretrained`, the HeadNeRF to start from; the experiment's own where None.
        loss_estimator: For the functional loss and the STED; one is trained where None.
        gaze_estimator: Measures and is calibrated; one is trained where None.
        network: Of the estimator that is trained to measure.
        estimator_epochs: Of estimators that are trained.
        identity_model: As of `gazenerf evaluate`.
        limit: Pairs of each person.
        seed: Of pairs, estimators, and what is drawn to calibrate.
        real: Of `calibration`, how many real pictures.
        samples: Of `calibration`, pictures in all, real and redirected ones.
        calibration_steps: Steps by which the estimator is fitted to a person.
    """

    experiment: str = option(help="within, cross, ablation, losses, pretrained or calibration", flag="experiment")
    data: Path = option(help="captures from `gazenerf synthesize` or `prepare`", metavar="DIR")
    out: Path = option(help="models, evaluations and tables; experiments of the same data share it", metavar="DIR")
    models: tuple[str, ...] = option((), "rows of the table (default: all)", metavar="NAME")
    test: tuple[str, ...] = option((), "of cross: other captures, and their name; several", metavar="NAME=DIR")
    dry_run: bool = option(False, "print what would be trained and measured, and do nothing")
    held_out: int = option(1, "people (the last ones) to measure on, never trained on", metavar="N")
    held_out_views: float = option(
        0.05, "views of each trained person kept out of training", metavar="SHARE", group=TRAINING
    )
    preset: str = option("small", "small (default), portrait, paper or tiny", metavar="NAME", group=TRAINING)
    settings: tuple[str, ...] = option(
        (), "change settings of the preset, of all fields", flag="--set", metavar="KEY=VALUE", group=TRAINING
    )
    sted_settings: tuple[str, ...] = option(
        (), "change settings of the STED", flag="--sted-set", metavar="KEY=VALUE", group=TRAINING
    )
    minutes: float | None = option(
        None, "shape every training to this long instead of to steps", metavar="MINUTES", group=TRAINING
    )
    initial: Path | None = option(
        None, "of pretrained: the HeadNeRF to start from (default: trained here)", flag="--from", metavar="FILE",
        group=TRAINING,
    )  # fmt: skip
    loss_estimator: Path | None = option(
        None, "for the functional loss and the STED, a small one (default: trained here)", metavar="FILE",
        group=TRAINING,
    )  # fmt: skip
    device: str = option("auto", "where to compute (default: auto)", choices=("auto", "cpu", "cuda"))
    seed: int = option(0, "of pairs, estimators and samples (default: 0)", metavar="S")
    limit: int | None = option(None, "at most N pairs of each person", metavar="N", group=MEASURING)
    gaze_estimator: Path | None = option(
        None, "reads gazes off pictures (default: trained here)", metavar="FILE", group=MEASURING
    )
    network: str = option(
        "resnet50", "of the estimator that is trained: resnet50 (default) or small", choices=NETWORKS, group=MEASURING
    )
    estimator_epochs: int | None = option(
        None, "passes of estimators that are trained (default: as train-estimator)", metavar="N", group=MEASURING
    )
    identity_model: Path | None = option(
        None, "ArcFace network in ONNX (default: dlib's, where it is installed)", metavar="FILE", group=MEASURING
    )
    real: tuple[int, ...] = option(
        (1, 2, 3, 4, 5, 6, 7, 8, 9), "real pictures of a person (default: 1 to 9)", metavar="N", group=CALIBRATION
    )
    samples: int = option(200, "pictures in all, the rest redirected (default: 200)", metavar="N", group=CALIBRATION)
    calibration_steps: int = option(
        100, "steps by which the estimator is fitted (default: 100)", metavar="N", group=CALIBRATION
    )
