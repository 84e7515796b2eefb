#!/usr/bin/env bash
# Rebuild the bundled field `portrait-sdf` on a CPU: distances from points of the head model's people, the colours of
# `portrait` settle on them, move to places on the template and settle again, then in windows, most of them at eyes and mouth,
# of more people, nearly half of whom open their mouths; detail of the skin, half precision, quality.
#   scripts/train_portrait_sdf.sh FOLDER [--minutes 80] [more arguments of `gazenerf train`]
# --minutes is the time in which the colours are learned from windows. Distances take an hour to two of one core, the
# settlings 19 and 45 minutes, the move 15, captures five. Persons 12 and 13 of the first 40 are left out of the
# pictures: the bundled subjects mia and noa are to stay strangers.
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
settings=(batch=2 muon_learning_rate=0.5 shell=0.024 shell_samples=6 perceptual=0.03
	perceptual_backbone=alexnet perceptual_stages=5)
few_steps=(warmup=5 perceptual_start=0.1 ema=0.97)

settle() { # captures, folder of the run, field to begin with, field settings as JSON, more arguments
	local data=$1 run=$2 from=$3 field=$4
	shift 4
	[ ! -f "$run/state.pt" ] || set -- "$@" --resume
	"${keep_memory[@]}" "${gazenerf[@]}" train --data "$folder/$data" --out "$run" --preset portrait --from "$from" \
		--held-out 0 --set "field_overrides=$field" "${settings[@]}" "$@"
}

"$python" "$scripts/learn_distances.py" --out "$folder/distances" --steps 27000 --people 500 --resume
"${gazenerf[@]}" synthesize --out "$folder/people" --people 40 --views 4 --size 512 --seed 1 --expressions few
"${gazenerf[@]}" synthesize --out "$folder/others" --people 40 --views 4 --size 512 --seed 2 --expressions few
"$python" "$scripts/join_captures.py" --base "$folder/people" --others "$folder/others" --held-out 12 13 \
	--out "$folder/learned"
"${gazenerf[@]}" synthesize --out "$folder/every" --people 40 --views 4 --size 512 --seed 1 --expressions all
"${gazenerf[@]}" synthesize --out "$folder/more" --people 40 --views 4 --size 512 --seed 11 --expressions all
"${gazenerf[@]}" synthesize --out "$folder/open" --people 70 --views 4 --size 512 --seed 21 --expressions open
"$python" "$scripts/join_captures.py" --base "$folder/every" --others "$folder/more" --held-out 12 13 \
	--out "$folder/both"
"$python" "$scripts/join_captures.py" --base "$folder/both" --others "$folder/open" --out "$folder/all"
sharp='"geometry": "distance", "template_frequencies": 8, "template_fall": 1.3, "surface_spread": 0.003, "shell": 0.024, "shell_samples": 6'
[ -f "$folder/settled/field.safetensors" ] ||
	settle learned "$folder/settled" "$folder/distances/field.safetensors" "{$sharp}" "${few_steps[@]}" learning_rate=3e-4 \
		--minutes 19
"$python" "$scripts/move_features.py" --checkpoint "$folder/settled/field.safetensors" --out "$folder/moved" --resume
placed="{$sharp, \"features_at\": \"template\"}"
[ -f "$folder/placed/field.safetensors" ] ||
	settle learned "$folder/placed" "$folder/moved/field.safetensors" "$placed" "${few_steps[@]}" learning_rate=5e-4 \
		eyes_weight=3 --minutes 45
settle all "$folder/run" "$folder/placed/field.safetensors" "$placed" warmup=20 perceptual_start=0 ema=0.996 \
	learning_rate=4e-4 eyes_weight=3 "window=[16,56]" window_eyes=0.3 window_mouth=0.4 --minutes 80 "$@"
fields=$("$python" -c 'from gazenerf.checkpoints import FIELDS; print(FIELDS)')
"$python" "$scripts/learn_detail.py" --checkpoint "$folder/run/field.safetensors" --spread 0.018 --half \
	--out "$fields/portrait-sdf.safetensors"
"$python" "$scripts/join_captures.py" --base "$folder/people" --more "$folder/people" --held-out $(seq 14 39) \
	--out "$folder/watched"
"${gazenerf[@]}" evaluate --data "$folder/watched" --held-out 2 --limit 2 --checkpoint portrait-sdf \
	--out "$folder/quality.json"
