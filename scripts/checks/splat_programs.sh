#!/usr/bin/env bash
# Install programs of others that open what `clgs export` writes, for
# tests/exports/splats/test_other_programs.py: scripts/checks/splat_programs.sh [FOLDER]
# splat-transform (PLY, SPZ, SOG), three.js and gltf-validator (GLB) from npm, gsply (PLY, SPZ, SOG)
# from PyPI, about 700 MB; needs npm and Node.js 20 or newer. Without them those tests are skipped.
set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.." && pwd)
folder=${1:-$root/build/splat_programs}
base=$root/.venv/bin/python
[ -x "$base" ] || base=python3

die() {
    printf 'splat_programs: error: %s\n' "$*" >&2
    exit 1
}

command -v npm >/dev/null || die "npm is missing; install Node.js 20 or newer"
mkdir -p "$folder"
printf '{"private": true}\n' >"$folder/package.json"
npm install --prefix "$folder" --no-fund --no-audit --ignore-scripts --loglevel error \
    @playcanvas/splat-transform@3.7.0 three@0.187 gltf-validator@2.0.0-dev.3.10 </dev/null ||
    die "npm could not install the programs"
"$base" -m venv "$folder/venv" </dev/null || die "cannot make $folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    gsply==0.4.6 imagecodecs zstandard </dev/null || die "pip could not install gsply"
if [ "$folder" != "$root/build/splat_programs" ]; then
    printf 'splat_programs: now set CLGS_SPLAT_PROGRAMS=%s\n' "$folder"
fi
