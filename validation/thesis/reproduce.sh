#!/usr/bin/env bash
# The thesis's experiment at a tenth of its size: 17 people, one finger, four sessions, whole views, all impostors; 12 minutes
# of two cores. Ends with the table of claims, with intervals as wide as so few fingers make them.
#
#   validation/thesis/reproduce.sh [--dry-run] [FOLDER]     # FOLDER: validation/out/reproduce unless given
#
# PYTHON (default: .venv/bin/python) and JOBS (default: 2) may be set. It may be stopped at any moment: the same command
# goes on where it was.
set -euo pipefail
cd "$(dirname "$0")/../.."

dry=
if [ "${1:-}" = --dry-run ]; then dry=yes; shift; fi
out=${1:-validation/out/reproduce}
python=${PYTHON:-.venv/bin/python}
jobs=${JOBS:-2}
cases=snk,pr,ea,ea-split,metric

step() {
    echo "+ $*"
    [ -n "$dry" ] || "$@"
}

experiment() {
    step "$python" validation/thesis/run.py "$1" --population "$out/people" --store "$out/store" \
        --out "$out/tables" --scratch "$out/scratch" --cases ${cases//,/ } --captures 6 --jobs "$jobs"
}

export OMP_NUM_THREADS=1
started=$SECONDS
step "$python" -m splitknit simulate population --out "$out/people" --seed 3170 --scale 0.4 --subjects 17 \
    --fingers right_index --sessions 4 --set sessions.partial_share=0 --workers "$jobs"
step "$python" -m splitknit batch "$out/people" --out "$out/store" --cases "$cases" --matchers thesis \
    --impostors 1 --seed 3170 --jobs "$jobs"
for part in cases fusion figures; do experiment "$part"; done
step "$python" validation/thesis/claims.py "$out/tables"
echo "$((SECONDS - started)) seconds"
