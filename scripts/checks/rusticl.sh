#!/usr/bin/env bash
# Unpack Mesa's rusticl, the front end of the open drivers of AMD and Intel, from Debian's packages
# (about 400 MB unpacked) into a folder of its own: scripts/checks/rusticl.sh [FOLDER].
# With llvmpipe it needs no card. Optional: one more implementation to compare bits with. It is
# slow, 0.1 training steps a second. Prints how to use it together with PoCL.
set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.." && pwd)
folder=${1:-$root/build/rusticl}
case $folder in /*) ;; *) folder=$PWD/$folder ;; esac
packages=(mesa-opencl-icd libclc-15-dev libllvmspirvlib15 libllvm15 libclang-cpp15
    libdrm2 libdrm-amdgpu1 libdrm-radeon1 libdrm-nouveau2 libelf1 libsensors5 libxml2 libedit2
    libz3-4 libbsd0 libmd0 libicu72)

die() {
    printf 'rusticl: error: %s\n' "$*" >&2
    exit 1
}

[ "$(uname -s) $(uname -m)" = "Linux x86_64" ] || die "written for Linux on x86-64 only"
if [ ! -f "$folder/whole" ]; then
    rm -rf "$folder" && mkdir -p "$folder/packages"
    (cd "$folder/packages" && apt-get -qq download "${packages[@]}" 2>/dev/null) ||
        die "apt-get gives no packages of Debian 12 here"
    for package in "$folder"/packages/*.deb; do
        dpkg -x "$package" "$folder"
    done
    touch "$folder/whole"
fi
[ -f /usr/lib/clc/spirv64-mesa3d-.spv ] || die "needs /usr/lib/clc: apt-get install libclc-15"
libraries=$folder/usr/lib/x86_64-linux-gnu
[ -f "$libraries/libRusticlOpenCL.so.1" ] || die "the packages hold no libRusticlOpenCL.so.1"
mkdir -p "$folder/vendors"
printf '%s\n' "$libraries/libRusticlOpenCL.so.1" >"$folder/vendors/rusticl.icd"
# The loader reads this folder instead of the system's: name the system's vendors again.
for vendor in /etc/OpenCL/vendors/*.icd; do
    case $vendor in *rusticl*) ;; *) [ -f "$vendor" ] && cp "$vendor" "$folder/vendors/" ;; esac
done

cat <<TEXT
rusticl is in $folder. Use it together with the other devices:
  export OCL_ICD_VENDORS=$folder/vendors LD_LIBRARY_PATH=$libraries RUSTICL_ENABLE=llvmpipe
  clgs devices
  CLGS_SPECIALISATION=gpu clgs conformance --device "Portable Computing Language" -o pocl.json --overwrite
  clgs conformance --device rusticl --check pocl.json
  clgs accept --quick --device rusticl -o accept.json
TEXT
