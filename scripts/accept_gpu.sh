#!/usr/bin/env bash
# Run `clgs accept` on a machine with a card, even if it has nothing but the driver: no list of
# drivers for OpenCL's loader, no network, no environment.
#
#   scripts/accept_gpu.sh --collect FOLDER [VERSION]
#       with a network: wheels of clgs and what it needs, for Python VERSION (3.12) on x86-64 Linux
#   scripts/accept_gpu.sh [--wheels FOLDER] [OPTIONS of clgs accept]
#       the kit; from these wheels, in addition to the packages of python3 (PYTHON names another); without
#       them from PYTHON, if it is set, else from the environment of scripts/setup.sh
#   scripts/accept_gpu.sh [--wheels FOLDER] --devices
#       only the devices; --libraries: only the drivers that are found
#
# A driver that cannot be loaded, or crashes, is named and left out. All that this writes is below
# build/accept_gpu.
set -euo pipefail

unset CDPATH
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
work=$root/build/accept_gpu
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
export PYTHONSAFEPATH=1 # not the clgs of the folder that this is called in
names="libnvidia-opencl.so.1 libamdocl64.so libigdrcl.so libintelocl.so libpocl.so.2"

say() {
    printf 'accept_gpu: %s\n' "$*" >&2
}

die() {
    say "error: $*"
    exit 1
}

usage() {
    say "error: $*; see scripts/accept_gpu.sh --help"
    exit 2
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

# Why a library does not load, in a process of its own; nothing if it does.
load_problem() {
    local said
    said=$("${PYTHON:-python3}" -c 'import ctypes, sys; ctypes.CDLL(sys.argv[1])' "$1" 2>&1) ||
        printf '%s\n' "${said##*OSError: }" | tail -n 1
}

# The first library of each name that loads, a line each.
libraries() {
    local name folder problem
    for name in $names; do
        while IFS= read -r folder; do
            [ -n "$folder" ] && [ -e "$folder/$name" ] || continue
            problem=$(load_problem "$folder/$name")
            if [ -z "$problem" ]; then
                printf '%s\n' "$folder/$name"
                break
            fi
            say "left out: $problem"
        done < <(folders)
    done
}

# Files *.icd that the machine lists already, a line each.
listed_drivers() {
    local listed=${OCL_ICD_VENDORS:-/etc/OpenCL/vendors}
    if [ -f "$listed" ]; then
        printf '%s\n' "$listed"
    elif [ -d "$listed" ]; then
        find -L "$listed" -maxdepth 1 -name '*.icd' | sort
    elif [ -n "${OCL_ICD_VENDORS:-}" ]; then
        say "OCL_ICD_VENDORS=$listed: no such file or folder; left out"
    fi
}

# Take a driver's file into the list, unless the drivers together crash with it.
add_driver() { # file, text
    local code=0
    printf '%s\n' "$2" >"$work/vendors/$1"
    # in a shell of its own, which keeps what is said of a crash to itself
    (OCL_ICD_VENDORS=$work/vendors "$python" -m clgs devices || exit) >/dev/null 2>&1 ||
        code=$?
    if [ "$code" -gt 128 ]; then
        say "left out: $2: crashes (signal $((code - 128))); install that driver again"
        rm "$work/vendors/$1"
    fi
}

# A folder of *.icd files: what the machine lists already, and drivers that it does not.
write_vendors() {
    local file library
    rm -rf "$work/vendors"
    mkdir -p "$work/vendors" || die "$work/vendors: cannot be made; see the line above"
    while IFS= read -r file; do
        add_driver "$(basename -- "$file")" "$(head -n 1 -- "$file")"
    done < <(listed_drivers)
    while IFS= read -r library; do
        if ! grep -qsF "$(basename -- "$library")" "$work"/vendors/*.icd; then
            add_driver "$(basename -- "$library").icd" "$library"
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
    done < <(libraries 2>/dev/null)
    export LD_LIBRARY_PATH=${LD_LIBRARY_PATH:-}
}

# Sets $python, which has clgs.
choose_python() { # folder of wheels, or nothing
    local usual=$root/.venv/bin/python
    if [ -z "$1" ] && [ -z "${PYTHON:-}" ]; then
        [ -x "$usual" ] || "$root/scripts/setup.sh"
        python=$usual
        return
    fi
    python=${PYTHON:-python3}
    command -v "$python" >/dev/null || die "$python: no such Python; PYTHON names the one to use"
    [ -n "$1" ] || return 0
    ls "$1"/clgs-*.whl >/dev/null 2>&1 || die "$1: holds no clgs-*.whl; make it with --collect"
    rm -rf "$work/site"
    "$python" -m pip install --quiet --no-index --no-deps --no-compile --target "$work/site" \
        "$1"/*.whl || die "pip could not install the wheels of $1; see the lines above"
    export PYTHONPATH=$work/site${PYTHONPATH:+:$PYTHONPATH}
}

# pycolmap is left out: it is the largest, and `clgs accept` has no photos without poses.
collect() { # folder, version of Python
    local folder=$1 version=${2:-3.12} platform platforms=() part
    [[ $version =~ ^3\.[0-9]+$ ]] || usage "$version: expected a version of Python such as 3.12"
    mkdir -p -- "$folder" 2>/dev/null || die "$folder: cannot be made, or is no folder"
    [ -z "$(ls -- "$folder")" ] || die "$folder: is not empty; name a new folder"
    part=$(mktemp -d)
    trap 'rm -rf "$part"' EXIT
    for platform in 2_28 2_27 2_17; do
        platforms+=(--platform "manylinux_${platform}_x86_64")
    done
    python3 -c '
import sys, tomllib
with open(sys.argv[1], "rb") as file:
    needed = tomllib.load(file)["project"]["dependencies"]
print("\n".join(one for one in needed if not one.startswith("pycolmap")))' "$root/pyproject.toml" \
        >"$part/requirements"
    mkdir "$part/wheels"
    python3 -m pip download --quiet --only-binary=:all: --python-version "$version" \
        --implementation cp "${platforms[@]}" --platform manylinux2014_x86_64 \
        --dest "$part/wheels" --requirement "$part/requirements" ||
        die "pip could not fetch the wheels; see the lines above"
    rm -f "$root"/dist/clgs-*x86_64.whl
    "$root/scripts/release/wheels.sh" x86_64
    cp "$root"/dist/clgs-*x86_64.whl "$part/wheels"
    cp "$part"/wheels/* "$folder"
    echo "accept_gpu: $(ls -- "$folder" | wc -l) wheels, $(du -sh -- "$folder" | cut -f1) in $folder"
}

case ${1:-} in
--help | -h)
    sed -n '2,/^set /{/^set /d; s/^# \{0,1\}//p}' "${BASH_SOURCE[0]}"
    exit
    ;;
--collect)
    [ -n "${2:-}" ] || usage "--collect needs a folder"
    collect "$2" "${3:-}"
    exit
    ;;
esac
wheels=
if [ "${1:-}" = --wheels ]; then
    [ -n "${2:-}" ] || usage "--wheels needs a folder"
    [ -d "$2" ] || usage "$2: no such folder"
    wheels=$(cd -- "$2" && pwd)
    shift 2
fi
if [ "${1:-}" = --libraries ]; then
    libraries
    exit
fi
choose_python "$wheels"
extend_library_path
write_vendors
say "OCL_ICD_VENDORS=$OCL_ICD_VENDORS"
"$python" -m clgs devices
[ "${1:-}" = --devices ] || exec "$python" -m clgs accept "$@"
