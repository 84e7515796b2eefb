#!/usr/bin/env bash
# Rebuild the bundled field `portrait-sdf` on a CPU: distances from points of the head model's people, then the colours
# of `portrait` settle on them, half-precision weights, quality.
#   scripts/train_portrait_sdf.sh FOLDER [--minutes 19] [more arguments of `gazenerf train`, such as --resume]
# --minutes is the time in which the colours settle. Distances take half an hour to an hour of one core, captures five
# minutes. Persons 12 and 13 are left out of the pictures: the bundled subjects mia and noa are to stay strangers.
# What was made before is kept, and a run that was stopped goes on.
set -euo pipefail
case ${1:-} in
"" | -*)
	echo "train_portrait_sdf.sh: give a folder for captures and the run first" >&2
	exit 2
	;;
esac
folder=$1
shift
scripts=$(cd "$(dirname "$0")" && pwd)
python=${PYTHON:-python}
gazenerf=("$python" -m gazenerf)
keep_memory=(env MALLOC_MMAP_THRESHOLD_=8589934592 MALLOC_TRIM_THRESHOLD_=17179869184 MALLOC_TOP_PAD_=1073741824)

"$python" "$scripts/learn_distances.py" --out "$folder/distances" --steps 9000 --people 500 --resume
"${gazenerf[@]}" synthesize --out "$folder/people" --people 40 --views 4 --size 512 --seed 1 --expressions few
"$python" "$scripts/join_captures.py" --base "$folder/people" --more "$folder/people" --held-out 12 13 \
	--out "$folder/learned"
"${keep_memory[@]}" "${gazenerf[@]}" train --data "$folder/learned" --out "$folder/run" --preset portrait \
	--from "$folder/distances/field.safetensors" --held-out 0 --minutes 19 \
	--set 'field_overrides={"geometry": "distance"}' batch=2 muon_learning_rate=0.5 learning_rate=3e-4 warmup=5 \
	perceptual=0.03 perceptual_backbone=alexnet perceptual_stages=5 perceptual_start=0.1 ema=0.97 "$@"
"$python" - "$folder/run/field.safetensors" <<'PY'
import sys
from dataclasses import replace

from gazenerf.checkpoints import FIELDS, load_field, save_field

field = load_field(sys.argv[1])
field.config = replace(field.config, surface_spread=0.006)
field.about["surface_spread"] = "0.01 while colours settled, 0.006 since"
save_field(field, FIELDS / "portrait-sdf.safetensors", half=True)
print("wrote portrait-sdf in half precision")
PY
"$python" "$scripts/join_captures.py" --base "$folder/people" --more "$folder/people" --held-out $(seq 14 39) \
	--out "$folder/watched"
"${gazenerf[@]}" evaluate --data "$folder/watched" --held-out 2 --limit 2 --checkpoint portrait-sdf \
	--out "$folder/quality.json"
