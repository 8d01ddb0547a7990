#!/usr/bin/env bash
# Compile the kernels' form for GPUs with the compilers of Intel, AMD and NVIDIA, and compare what
# each kernel takes with docs/benchmarks/registers.json; no card is needed:
#   scripts/checks/vendor_compilers.sh [check|record] [FOLDER]
# Debian's packages and ptxas from PyPI are unpacked into FOLDER (build/vendor_compilers by default);
# nothing is installed in the system.
set -euo pipefail

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.."
action=${1:-check}
folder=${2:-build/vendor_compilers}
python=${PYTHON:-.venv/bin/python}
[ -x "$python" ] || python=python3
packages=(intel-opencl-icd libigc1 libigdfcl1 libigdgmm12 libopencl-clang14 libllvmspirvlib14
    rocm-device-libs)

if [ ! -f "$folder/complete" ]; then
    mkdir -p "$folder/packages"
    if command -v apt-get >/dev/null 2>&1 &&
        (cd "$folder/packages" && apt-get -qq download "${packages[@]}" 2>/dev/null); then
        for package in "$folder"/packages/*.deb; do
            dpkg -x "$package" "$folder"
        done
        # The libraries are older than gfx1100, but a number is all that they must know of a chip.
        echo '@__oclc_ISA_version = linkonce_odr protected local_unnamed_addr addrspace(4) constant i32 11000' |
            clang-15 -target amdgcn-amd-amdhsa -nogpulib -x ir -c -emit-llvm -w - \
                -o "$(echo "$folder"/usr/lib/*/amdgcn/bitcode)/oclc_isa_version_1100.bc"
    else
        echo "vendor_compilers: skipped Intel and AMD: no packages of Debian 12 here"
    fi
    "$python" -m pip install --quiet --disable-pip-version-check --no-deps \
        --target "$folder/python" nvidia-cuda-nvcc-cu12==12.9.86 </dev/null &&
        chmod +x "$folder"/python/nvidia/cuda_nvcc/bin/ptxas && touch "$folder/complete"
fi
"$python" scripts/checks/vendor_compilers.py "$action" docs/benchmarks/registers.json "$folder"
