#!/usr/bin/env bash
# Install if needed, reproduce the APPS study, and solve 1,000 poses of a Panda. Results go to out/.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
bash scripts/setup.sh
export PATH="$PWD/.venv/bin:$PATH" OMP_WAIT_POLICY=passive
mkdir -p out
set -x
ikgrad reproduce apps --out out/apps --force
ikgrad sample --robot panda --count 1000 --seed 0 -o out/panda_poses.csv --force
ikgrad solve --robot panda out/panda_poses.csv -o out/panda_joints.csv --plot out/panda_solve.png --force
