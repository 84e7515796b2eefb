#!/bin/bash
# All six experiments of the paper at a size for one core: benchmarks/experiments.sh FOLDER
#
# Captures, models, evaluations and tables are written to FOLDER. Run it again after it was stopped: it goes on.
# docs/experiments.md has what came out.
set -e
mkdir -p "${1:?name a folder}"
cd "$1"
gazenerf="${PYTHON:-python} -m gazenerf"
$gazenerf synthesize --out captures --people 36 --views 108 --size 128 --layout xgaze18 --seed 21 --workers 1
$gazenerf synthesize --out others --people 8 --views 18 --size 128 --layout random --expressions few --seed 77 --workers 1
$gazenerf synthesize --out traced --people 6 --views 18 --size 128 --layout xgaze18 --seed 91 --renderer mitsuba \
    --samples 36 --workers 1
judge=$(${PYTHON:-python} -c 'from gazenerf.training.gaze_estimator import BUNDLED; print(BUNDLED)')
options=(
    --data captures --out experiments --held-out 8 --limit 6 --gaze-estimator "$judge" --estimator-epochs 8 --preset small
    --set 'field_overrides={"hidden": 96, "layers": 6, "skip_after": 3, "feature_size": 32, "feature_channels": 48}'
    steps=900 batch=2 perceptual_start=0.15 ema=0.99 functional_content=0.03
    --sted-set 'network={"image_size": 32, "growth": 8, "appearance": 128}' steps=1200 batch=4 learning_rate=1e-3
    adversarial=0 directions=0
)
failed=0
$gazenerf experiment within "${options[@]}" || failed=1
$gazenerf experiment cross "${options[@]}" --test others=others traced=traced || failed=1
$gazenerf experiment pretrained "${options[@]}" || failed=1
$gazenerf experiment calibration "${options[@]}" --real 1 2 4 6 9 --samples 60 --calibration-steps 40 || failed=1
$gazenerf experiment ablation "${options[@]}" || failed=1
$gazenerf experiment losses "${options[@]}" || failed=1
exit $failed
