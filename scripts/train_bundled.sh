#!/usr/bin/env bash
# Rebuild the bundled field and subjects on a machine with a GPU: captures, training, half-precision weights, quality.
#   scripts/train_bundled.sh FOLDER [--minutes 9] [--dry-run] [more arguments of `gazenerf train`, such as --resume]
# --minutes is the time of training alone; the schedule is shaped to it, so that the run ends finished at any speed.
# --dry-run does all of it at toy size on the CPU in about a minute and writes nothing outside FOLDER.
# Two sets are synthesized with one seed: `people`, 396 people with 12 views each, and `watched`, persons 0 to 13 with
# 60 views each, with few expressions at a time, as the bundled field has seen them. `learned` joins them without
# persons 12 and 13, whom no training sees; `watched` is measured on: every twentieth view of persons 0 to 11, and 12
# and 13. What was synthesized before is kept.
# The malloc settings of training keep freed memory in the process, which halves the time of a step on a CPU.
set -euo pipefail
case ${1:-} in
"" | -*)
	echo "train_bundled.sh: give a folder for captures and the run first" >&2
	exit 2
	;;
esac
folder=$1
shift
minutes=9
dry=
more=()
while [ $# -gt 0 ]; do
	case $1 in
	--minutes)
		minutes=${2:?--minutes needs a number}
		shift 2
		;;
	--dry-run)
		dry=1
		shift
		;;
	*)
		more+=("$1")
		shift
		;;
	esac
done
scripts=$(cd "$(dirname "$0")" && pwd)
python=${PYTHON:-python}
gazenerf=("$python" -m gazenerf)
keep_memory=(env MALLOC_MMAP_THRESHOLD_=8589934592 MALLOC_TRIM_THRESHOLD_=17179869184 MALLOC_TOP_PAD_=1073741824)

people=396 views=12 watched_views=60 size=512 share=0.05
workers=()
train=()
measure=(--limit 3)
subjects=()
weights=$("$python" -c 'from gazenerf.checkpoints import BUNDLED; print(BUNDLED)')
if [ -n "$dry" ]; then
	people=15 views=1 watched_views=2 size=64 share=0.5 minutes=0.05
	workers=(--workers 1)
	train=(--device cpu --set batch=2 warmup=5 perceptual=0
		'field_overrides={"feature_size": 16, "hidden": 32, "feature_channels": 24}')
	measure=(--limit 1 --no-iris)
	subjects=(--out "$folder/subjects")
	weights=$folder/field.safetensors
	mkdir -p "$folder/subjects"
fi

"${gazenerf[@]}" synthesize --out "$folder/people" --people "$people" --views "$views" --size "$size" --seed 1 \
	--expressions few ${workers[@]+"${workers[@]}"}
"${gazenerf[@]}" synthesize --out "$folder/watched" --people 14 --views "$watched_views" --size "$size" --seed 1 \
	--expressions few ${workers[@]+"${workers[@]}"}
"$python" "$scripts/join_captures.py" --base "$folder/people" --more "$folder/watched" --held-out 12 13 \
	--out "$folder/learned"
"${keep_memory[@]}" "${gazenerf[@]}" train --data "$folder/learned" --out "$folder/run" --preset portrait --held-out 0 \
	--held-out-views "$share" --minutes "$minutes" ${train[@]+"${train[@]}"} ${more[@]+"${more[@]}"}
"$python" "$scripts/make_subjects.py" --data "$folder/watched" --trained 0 1 2 3 4 5 --held-out 12 13 \
	${subjects[@]+"${subjects[@]}"}
"$python" - "$folder/run/field.safetensors" "$weights" <<'PY'
import sys

from gazenerf.checkpoints import load_field, save_field

save_field(load_field(sys.argv[1]), sys.argv[2], half=True)
print(f"wrote {sys.argv[2]} in half precision")
PY
"${gazenerf[@]}" evaluate --data "$folder/watched" --held-out 2 --held-out-views "$share" --checkpoint "$weights" \
	--out "$folder/quality.json" "${measure[@]}"
