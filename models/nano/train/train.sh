#!/bin/sh
# Trains the nano model from a dataset folder, exports, checks and evaluates it.
# Usage: models/nano/train/train.sh DATASET RUN_FOLDER [options of `python -m nano run`]
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
data=$1 out=$2
shift 2
mkdir -p "$out"
PYTHONPATH=$here exec "${PYTHON:-python3}" -m nano run --data "$data" --out "$out" --model "$out/model" --reference "$out/reference" "$@"
