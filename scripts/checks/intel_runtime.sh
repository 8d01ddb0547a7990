#!/usr/bin/env bash
# Install Intel's OpenCL runtime for CPUs from PyPI (about 910 MB) into a virtual environment of its
# own, and write the .icd file that the packages lack: scripts/checks/intel_runtime.sh [FOLDER].
# Optional: a second implementation to compare bits with. Prints how to use it together with PoCL.
set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.." && pwd)
folder=${1:-$root/build/intel_runtime}
case $folder in /*) ;; *) folder=$PWD/$folder ;; esac
base=$root/.venv/bin/python
[ -x "$base" ] || base=python3

die() {
    printf 'intel_runtime: error: %s\n' "$*" >&2
    exit 1
}

[ "$(uname -s) $(uname -m)" = "Linux x86_64" ] || die "the packages are for Linux on x86-64 only"
# intel-cmplr-lib-rt holds libimf and libsvml: not declared as a dependency, and without them the
# runtime is left out without a word.
if ! compgen -G "$folder/venv/lib/libintelocl.so*" >/dev/null; then
    "$base" -m venv "$folder/venv" </dev/null || die "cannot make $folder/venv"
    "$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
        intel-opencl-rt intel-cmplr-lib-rt </dev/null || die "pip could not install the runtime"
fi
library=$(find "$folder/venv/lib" -maxdepth 1 -name 'libintelocl.so*' | sort | head -n 1)
[ -n "$library" ] || die "the packages hold no libintelocl.so; was their layout changed?"
mkdir -p "$folder/vendors"
printf '%s\n' "$library" >"$folder/vendors/intel.icd"
# The loader reads this folder instead of the system's: name the system's vendors again.
for vendor in /etc/OpenCL/vendors/*.icd; do
    [ -f "$vendor" ] && cp "$vendor" "$folder/vendors/"
done

cat <<TEXT
Intel's OpenCL runtime is in $folder. Use it together with the other devices:
  export OCL_ICD_VENDORS=$folder/vendors
  clgs devices
  clgs conformance --device "Portable Computing Language" -o pocl.json --overwrite
  clgs conformance --device "Intel(R) OpenCL" --check pocl.json
TEXT
