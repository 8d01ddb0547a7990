#!/usr/bin/env bash
# Compile the kernels' form for GPUs with the compilers of Intel, AMD and NVIDIA, and compare what
# each kernel takes with docs/benchmarks/registers.json; no card is needed:
#   scripts/checks/vendor_compilers.sh [check|record] [FOLDER]
# Debian's packages and ptxas from PyPI are unpacked into FOLDER (build/vendor_compilers by default);
# nothing is installed in the system. Two minutes on two cores.
set -euo pipefail

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.."
action=${1:-check}
folder=${2:-build/vendor_compilers}
python=${PYTHON:-.venv/bin/python}
[ -x "$python" ] || python=python3
packages=(intel-opencl-icd libigc1 libigdfcl1 libigdgmm12 libopencl-clang14 libllvmspirvlib14
    rocm-device-libs clang-19 libclang-cpp19 libllvm19 libclang-common-19-dev)

# Each half is marked as whole by a file of its own, so that the next call fetches what failed.
fetch_packages() {
    rm -rf "$folder/packages" && mkdir -p "$folder/packages"
    (cd "$folder/packages" && apt-get -qq download "${packages[@]}" 2>/dev/null) || return 1
    for package in "$folder"/packages/*.deb; do
        dpkg -x "$package" "$folder" || return 1
    done
    touch "$folder/packages/whole"
}

fetch_ptxas() {
    "$python" -m pip install --quiet --disable-pip-version-check --no-deps --upgrade \
        --target "$folder/python" nvidia-cuda-nvcc-cu12==12.9.86 </dev/null || return 1
    chmod +x "$folder"/python/nvidia/cuda_nvcc/bin/ptxas && touch "$folder/python/whole"
}

[ -f "$folder/packages/whole" ] || fetch_packages ||
    echo "vendor_compilers: skipped Intel and AMD: apt-get gives no packages of Debian 12 here"
[ -f "$folder/python/whole" ] || fetch_ptxas ||
    echo "vendor_compilers: skipped NVIDIA: pip gives no ptxas here"
"$python" scripts/checks/vendor_compilers.py "$action" docs/benchmarks/registers.json "$folder"
