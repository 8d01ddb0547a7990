#!/usr/bin/env bash
# Set up all that clgs needs: a virtual environment (.venv, or CLGS_VENV) with the package and its
# development tools, and an OpenCL device if there is none. Safe to run again, and then quick.
# Other scripts source it and use $root, $venv, $python, say, die, on_debian_as_root, apt_install
# and ensure_device.
set -euo pipefail
unset CDPATH # else cd would print the folder

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
venv=${CLGS_VENV:-$root/.venv}
case $venv in /*) ;; *) venv=$PWD/$venv ;; esac
python=$venv/bin/python
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore

say() {
    printf 'setup: %s\n' "$*"
}

die() {
    printf 'setup: error: %s\n' "$*" >&2
    exit 1
}

on_debian_as_root() {
    [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1
}

apt_install() {
    say "apt-get install $*"
    if [ -z "${apt_updated:-}" ]; then
        DEBIAN_FRONTEND=noninteractive apt-get update -qq </dev/null || return 1
        apt_updated=1
    fi
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" \
        </dev/null >/dev/null
}

# The first Python of at least 3.11 that passes a one-line test.
find_python() {
    local name
    for name in python3.13 python3.12 python3.11 python3 python; do
        if command -v "$name" >/dev/null 2>&1 &&
            "$name" -c "import sys; sys.exit(sys.version_info < (3, 11))" >/dev/null 2>&1 &&
            "$name" -c "$1" >/dev/null 2>&1; then
            printf '%s\n' "$name"
            return 0
        fi
    done
    return 1
}

make_venv() {
    local base
    if base=$(find_python 'import venv, ensurepip'); then
        :
    elif base=$(find_python ''); then
        on_debian_as_root || die "$base lacks the venv module; install python3-venv"
        apt_install "$(basename -- "$base")-venv" || apt_install python3-venv ||
            die "python3-venv cannot be installed; see the lines above"
    else
        if on_debian_as_root; then
            apt_install python3 python3-venv || true
        fi
        base=$(find_python 'import venv, ensurepip') ||
            die "Python 3.11 or newer is needed; install it and run this again"
    fi
    say "making $venv with $("$base" --version)"
    "$base" -m venv "$venv" </dev/null || die "cannot make the virtual environment $venv"
}

# The package builds a C extension: a compiler and Python's headers.
ensure_compiler() {
    local header='import os, sys, sysconfig
sys.exit(not os.path.isfile(os.path.join(sysconfig.get_path("include"), "Python.h")))'
    if ! command -v "${CC:-cc}" >/dev/null 2>&1; then
        on_debian_as_root || die "no C compiler; install one (Debian, Ubuntu: build-essential)"
        apt_install build-essential || die "build-essential cannot be installed"
    fi
    if ! "$python" -c "$header"; then
        on_debian_as_root || die "Python.h is missing; install Python's headers (python3-dev)"
        apt_install "python$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-dev" ||
            die "python3-dev cannot be installed"
    fi
}

# Web pages of scenes need a compiler for WebAssembly when the package is built; nothing else does.
ensure_web_compiler() {
    local name
    for name in wasm-ld zig python-zig; do
        command -v "$name" >/dev/null 2>&1 && return 0
    done
    if ! { on_debian_as_root && apt_install clang lld; }; then
        say "no clang with lld, and no Zig: \`clgs export\` will write no web pages"
    fi
}

# Changes whenever the package must be installed again.
fingerprint() {
    {
        printf '%s\n' "$root"
        command -v clang wasm-ld zig python-zig || true
        cat "$root/pyproject.toml" "$root/CMakeLists.txt" "$root/web/CMakeLists.txt"
        find "$root/codec_c" "$root/web/wasm" -type f -name '*.[ch]' | LC_ALL=C sort | while IFS= read -r file; do
            cat "$file"
        done
    } | cksum
}

# uv needs a fifth of the time of pip, but does not read its settings: with an index or a proxy, pip
# installs. If uv fails, pip tries again and says why.
install_by_uv() {
    ! "$python" -m pip config list | grep -Eq 'index|proxy' &&
        "$python" -m pip install --quiet uv 2>/dev/null &&
        "$venv/bin/uv" pip install --quiet --python "$python" -e '.[dev]' 2>/dev/null
}

install_package() {
    local stamp=$venv/clgs.stamp
    if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$(fingerprint)" ]; then
        return 0
    fi
    ensure_compiler
    ensure_web_compiler
    say "installing clgs and its tools into $venv (a minute or two the first time)"
    (cd "$root" && { install_by_uv || "$python" -m pip install --quiet -e '.[dev]'; } </dev/null) ||
        die "pip could not install clgs; see the lines above"
    fingerprint >"$stamp"
}

# An emulator, or a platform without devices, counts as none.
has_device() {
    "$1" -c '
import sys
from clgs.opencl.choose import list_devices
sys.exit(all("oclgrind" in device.platform.name.lower() for device in list_devices()))'
}

# Give the environment of Python $1 an OpenCL device.
ensure_device() {
    has_device "$1" && return 0
    if on_debian_as_root && apt_install pocl-opencl-icd && has_device "$1"; then
        return 0
    fi
    say "no OpenCL device; installing PoCL from PyPI (slower than a distribution's pocl-opencl-icd)"
    "$1" -m pip install --quiet 'pyopencl[pocl]' </dev/null || true
    has_device "$1" ||
        die "no OpenCL device; install pocl-opencl-icd or a vendor's OpenCL driver"
}

"$python" -c '' >/dev/null 2>&1 || make_venv
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    die "$venv holds an old Python; remove it, or set CLGS_VENV, and run this again"
install_package
ensure_device "$python"
if [ "${BASH_SOURCE[0]}" = "$0" ]; then
    say "ready: . $venv/bin/activate && clgs --help"
fi
