#!/usr/bin/env bash
# Run `clgs accept` on a machine with a card, even if it has nothing but the driver: no list of
# drivers for OpenCL's loader, no network, no environment.
#
#   scripts/accept_gpu.sh --collect FOLDER [VERSION]
#       with a network: wheels of clgs and what it needs, for Python VERSION (3.12) on x86-64 Linux
#   scripts/accept_gpu.sh [--wheels FOLDER] [OPTIONS of clgs accept]
#       the kit; from these wheels, beside the packages of python3 (PYTHON names another), or from
#       the environment of scripts/setup.sh
#   scripts/accept_gpu.sh [--wheels FOLDER] --devices
#       only the devices; --libraries: only the drivers that are found
#
# All that it writes is below build/accept_gpu.
set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
work=$root/build/accept_gpu
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
export PYTHONSAFEPATH=1 # not the clgs of the folder that this is called in
names="libnvidia-opencl.so.1 libamdocl64.so libigdrcl.so libintelocl.so libpocl.so.2"

die() {
    printf 'accept_gpu: error: %s\n' "$*" >&2
    exit 1
}

# Folders that drivers lie in, a line each: those of the loader, then usual ones that it may not know.
folders() {
    printf '%s\n' "${LD_LIBRARY_PATH:-}" | tr ':' '\n'
    { ldconfig -p 2>/dev/null || /sbin/ldconfig -p 2>/dev/null || true; } |
        sed -n 's|.*=> \(.*\)/[^/]*$|\1|p' | sort -u
    printf '%s\n' /usr/local/nvidia/lib64 /usr/local/nvidia/lib /usr/lib64 /usr/lib/*-linux-gnu \
        /usr/lib/*-linux-gnu/intel-opencl /usr/lib/wsl/lib /opt/rocm*/lib /opt/rocm*/opencl/lib \
        /opt/amdgpu*/lib/*-linux-gnu /run/opengl-driver/lib /opt/intel/oneapi/compiler/latest/lib
}

# The first library of each name, a line each.
libraries() {
    local name folder
    for name in $names; do
        while IFS= read -r folder; do
            if [ -n "$folder" ] && [ -e "$folder/$name" ]; then
                printf '%s\n' "$folder/$name"
                break
            fi
        done < <(folders)
    done
}

# A folder of *.icd files: what the machine lists already, and drivers that it does not.
write_vendors() {
    local library listed=${OCL_ICD_VENDORS:-/etc/OpenCL/vendors}
    rm -rf "$work/vendors"
    mkdir -p "$work/vendors"
    if [ -d "$listed" ]; then
        find "$listed" -name '*.icd' -exec cp {} "$work/vendors" \;
    fi
    while IFS= read -r library; do
        if ! grep -qsF "$(basename -- "$library")" "$work"/vendors/*.icd; then
            printf '%s\n' "$library" >"$work/vendors/$(basename -- "$library").icd"
        fi
    done < <(libraries)
    [ -n "$(ls "$work/vendors")" ] || die "no OpenCL driver: none of $names is in the usual folders; \
install the card's driver, name its folder in LD_LIBRARY_PATH, or, in a container, \
set NVIDIA_DRIVER_CAPABILITIES=all"
    export OCL_ICD_VENDORS=$work/vendors
}

# Drivers in folders that the loader does not know bring further libraries from there.
extend_library_path() {
    local library folder
    while IFS= read -r library; do
        folder=$(dirname -- "$library")
        case ":${LD_LIBRARY_PATH:-}:" in
        *":$folder:"*) ;;
        *) LD_LIBRARY_PATH=${LD_LIBRARY_PATH:+$LD_LIBRARY_PATH:}$folder ;;
        esac
    done < <(libraries)
    export LD_LIBRARY_PATH=${LD_LIBRARY_PATH:-}
}

# Sets $python, which has clgs.
choose_python() { # folder of wheels, or nothing
    if [ -z "$1" ]; then
        [ -x "$root/.venv/bin/python" ] || "$root/scripts/setup.sh"
        python=$root/.venv/bin/python
        return
    fi
    python=${PYTHON:-python3}
    ls "$1"/clgs-*.whl >/dev/null 2>&1 || die "$1: holds no clgs-*.whl; make it with --collect"
    rm -rf "$work/site"
    "$python" -m pip install --quiet --no-index --no-deps --no-compile --target "$work/site" \
        "$1"/*.whl || die "pip could not install the wheels of $1; see the lines above"
    export PYTHONPATH=$work/site${PYTHONPATH:+:$PYTHONPATH}
}

# pycolmap is left out: it is the largest, and `clgs accept` has no photos without poses.
collect() { # folder, version of Python
    local folder=$1 version=${2:-3.12} platform platforms=()
    for platform in 2_28 2_27 2_17; do
        platforms+=(--platform "manylinux_${platform}_x86_64")
    done
    mkdir -p "$folder"
    "$root/scripts/release/wheels.sh" x86_64
    cp "$root"/dist/clgs-*x86_64.whl "$folder"
    python3 -c '
import sys, tomllib
with open(sys.argv[1], "rb") as file:
    needed = tomllib.load(file)["project"]["dependencies"]
print("\n".join(one for one in needed if not one.startswith("pycolmap")))' "$root/pyproject.toml" \
        >"$folder/requirements.txt"
    python3 -m pip download --quiet --only-binary=:all: --python-version "$version" \
        --implementation cp "${platforms[@]}" --platform manylinux2014_x86_64 \
        --dest "$folder" --requirement "$folder/requirements.txt" ||
        die "pip could not fetch the wheels; see the lines above"
    rm "$folder/requirements.txt"
    echo "accept_gpu: $(ls "$folder" | wc -l) wheels, $(du -sh "$folder" | cut -f1) in $folder"
}

case ${1:-} in
--collect)
    collect "${2:?accept_gpu: --collect needs a folder}" "${3:-}"
    exit
    ;;
--libraries)
    libraries
    exit
    ;;
esac
wheels=
if [ "${1:-}" = --wheels ]; then
    wheels=$(cd -- "${2:?accept_gpu: --wheels needs a folder}" && pwd) || die "$2: no such folder"
    shift 2
fi
choose_python "$wheels"
extend_library_path
write_vendors
printf 'accept_gpu: OCL_ICD_VENDORS=%s\n' "$OCL_ICD_VENDORS"
"$python" -m clgs.cli.main devices
[ "${1:-}" = --devices ] || exec "$python" -m clgs.cli.main accept "$@"
