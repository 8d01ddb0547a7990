#!/usr/bin/env bash
# Build the source archive and, from it, wheels for Linux into dist: scripts/release/wheels.sh
# [ARCH...], by default x86_64 and aarch64. Needs no container and no compiler of the machine: the
# ziglang wheel compiles for glibc 2.28, for another processor too. The wheels are checked without
# being run; scripts/release/try_wheel.sh runs one.
set -euo pipefail
unset CDPATH # else cd would print the folder

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.." && pwd)
output=$root/dist
tools=$root/build/release_tools
bin=$tools/bin
glibc=2.28
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
SOURCE_DATE_EPOCH=$(git -c "safe.directory=$root" -C "$root" log -1 --format=%ct)
export SOURCE_DATE_EPOCH # the times of the files in the archives: the same commit, the same bytes

die() {
    printf 'wheels: error: %s\n' "$*" >&2
    exit 1
}

# The packages that pyproject.toml lists under "release", a line each.
release_packages() {
    "$bin/python" -c '
import sys, tomllib
with open(sys.argv[1], "rb") as file:
    project = tomllib.load(file)
print("\n".join(project["dependency-groups"]["release"] + project["build-system"]["requires"]))' \
        "$root/pyproject.toml"
}

install_tools() {
    [ -x "$bin/python" ] || python3 -m venv "$tools" </dev/null || die "cannot make $tools"
    release_packages | "$bin/python" -m pip install --quiet -r /dev/stdin ||
        die "pip could not install the tools; see the lines above"
}

# Programs as CMake wants them: a path without further words.
write_compiler() {
    local arch=$1 name
    printf '#!/bin/sh\nexec "%s" -m ziglang cc -target %s-linux-gnu.%s "$@"\n' \
        "$bin/python" "$arch" "$glibc" >"$work/cc"
    for name in ar ranlib; do
        printf '#!/bin/sh\nexec "%s" -m ziglang %s "$@"\n' "$bin/python" "$name" >"$work/$name"
    done
    chmod +x "$work/cc" "$work/ar" "$work/ranlib"
}

# Without build isolation: pip would install CMake for the other processor.
build_wheel() {
    local arch=$1
    write_compiler "$arch"
    env CC="$work/cc" LDFLAGS=-s PATH="$bin:$PATH" \
        _PYTHON_HOST_PLATFORM="linux-$arch" \
        CMAKE_ARGS="-DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=$arch \
-DCMAKE_AR=$work/ar -DCMAKE_RANLIB=$work/ranlib -DCLGS_WERROR=ON" \
        ZIG_GLOBAL_CACHE_DIR="$tools/zig" ZIG_LOCAL_CACHE_DIR="$tools/zig" \
        "$bin/python" -m build --wheel --no-isolation --skip-dependency-check \
        -C install.strip=false --outdir "$work/$arch" "$work/source" >"$work/$arch.log" ||
        { cat "$work/$arch.log" >&2 && die "no wheel for $arch"; }
    # auto: the oldest glibc that will do; others can be named for this machine's processor alone.
    PATH="$bin:$PATH" "$bin/auditwheel" repair --plat auto \
        --only-plat --wheel-dir "$work/repaired/$arch" "$work/$arch"/*.whl
}

check() {
    local wheel
    for wheel in "$work/repaired/$1"/*.whl; do
        "$bin/auditwheel" show "$wheel"
        "$bin/abi3audit" --strict --summary "$wheel"
        "$bin/python" "$root/scripts/checks/check_wheel.py" "$wheel"
        "$bin/check-wheel-contents" "$wheel"
        "$bin/twine" check --strict "$wheel"
        rm -f "$output"/clgs-*"_$1.whl"
        mv "$wheel" "$output"
    done
}

[ "$(uname -s)" = Linux ] || die "elsewhere cibuildwheel builds them, see .github/workflows"
[ $# -gt 0 ] || set -- x86_64 aarch64
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
install_tools
"$bin/python" -m build --sdist --no-isolation --skip-dependency-check --outdir "$work" "$root" >/dev/null
mkdir -p "$work/source" "$output"
for archive in "$work"/clgs-*.tar.gz; do
    tar -xzf "$archive" --strip-components 1 -C "$work/source"
    mv "$archive" "$output"
done
for arch in "$@"; do
    build_wheel "$arch"
    check "$arch"
done
"$bin/twine" check --strict "$output/$(basename -- "$archive")"
